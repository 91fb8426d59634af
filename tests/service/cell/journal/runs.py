"""Runs to record."""

from service.messages import Run, RunState


def run(number: int, state: RunState = RunState.SUCCEEDED, **changes: object) -> Run:
    fields = {"id": f"run-{number}", "recipe": "r", "seed": number, "state": state, "requested_at": float(number)}
    return Run.model_validate(fields | changes)
