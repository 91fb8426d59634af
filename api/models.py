"""Requests and answers of the HTTP API, beside the control plane's own models in `service.messages`."""

from typing import Self

from pydantic import BaseModel, ConfigDict, Field
from pydantic.config import JsonDict

from service.client import CellClient
from service.faults import FaultCode
from service.logs import log_fault
from service.messages import (
    NAME_PATTERN,
    CellState,
    Counters,
    Latch,
    Measured,
    Run,
    Telemetry,
)

_RUN_EXAMPLE: JsonDict = {
    "id": "run-5f2c81d0a94e",
    "recipe": "triangle-2mm",
    "seed": 7,
    "state": "SUCCEEDED",
    "code": None,
    "text": "",
    "requested_at": 1795356192.4,
    "ended_at": 1795356199.1,
    "requested_by": "api",
    "idempotency_key": "5e0f6a2e",
    "policy_sha256": None,
    "phase": "LOCKED",
    "steps": 52,
    "depth_m": 0.0102,
    "peak_force_n": 14.8,
    "duration_s": 6.1,
}


class StartBody(BaseModel):
    """Request one insertion."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"examples": [{"recipe": "triangle-2mm", "seed": 7}, {"recipe": "triangle-2mm"}]},
    )

    recipe: str = Field(pattern=NAME_PATTERN, description="One of the recipes that `GET /status` lists.")
    seed: int | None = Field(
        None,
        ge=0,
        lt=2**53,
        strict=True,
        description="Seed of the simulated world; drawn at random if left out. A real arm takes none.",
    )
    operator: str = Field("", max_length=64, description="Name of the requester; recorded in the run's `requested_by`.")


class ResetBody(BaseModel):
    """Acknowledge the latched fault. Nothing moves, and no run resumes."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [
                {"operator": "M. Sato", "comment": "chip in the hole, removed", "acknowledge": "FORCE_CEILING"}
            ]
        },
    )

    operator: str = Field(min_length=1, max_length=64, description="Name of the person who looked at the cell.")
    comment: str = Field("", max_length=500, description="Findings at the cell; recorded in its journal.")
    acknowledge: FaultCode | None = Field(
        None, description="Fault code that the operator saw. The reset is refused if another fault is in force by now."
    )


class CellStatus(BaseModel):
    """State of the cell as last measured, or UNKNOWN.

    `state` is the state in the control process's last heartbeat, if that heartbeat is fresh. Otherwise `state` is
    UNKNOWN and `measured` is left out.
    """

    cell: str
    state: CellState
    heartbeat_age_s: float | None = Field(
        description="Age of the control process's last heartbeat, s; null if there was none."
    )
    last_known_state: CellState | None = Field(
        description="State in the last heartbeat. While `state` is UNKNOWN, the cell may have changed since."
    )
    can_start: bool
    why_not: str | None = None
    latch: Latch | None = None
    run: Run | None = None
    measured: Measured | None = Field(
        default=None, description="Newest sample; `sample_age_s` is its age when this answer was sent."
    )
    force_ceiling_n: float | None = None
    recipes: tuple[str, ...] = ()
    driver: str | None = None
    mode: str | None = None
    degradations: tuple[str, ...] = Field(
        (), description="What works less well than it should, of the control process and of this server."
    )
    counters: Counters | None = None
    service_epoch: str | None = None

    @classmethod
    def now(cls, cell: str, client: CellClient, note: str | None = None) -> Self:
        """Build from the last heartbeat.

        Args:
            cell: id of the cell, used if there was no heartbeat yet.
            client: client that holds the heartbeat and its age.
            note: reason for the control process's silence, if known.
        """
        status = client.last_status
        age_s = client.heartbeat_age_s
        own = () if (lost := log_fault()) is None else (f"this server: {lost}",)
        if status is None or not client.is_alive:
            heard = "was never heard" if status is None else f"was last heard {age_s:.1f} s ago"
            return cls(
                cell=cell,
                state=CellState.UNKNOWN,
                heartbeat_age_s=None if status is None else age_s,
                last_known_state=None if status is None else status.state,
                can_start=False,
                why_not=f"The control process {heard}." + (f" {note}" if note else ""),
                recipes=() if status is None else status.recipes,
                degradations=own,
                service_epoch=None if status is None else status.service_epoch,
            )
        measured = status.measured
        if measured is not None:
            measured = measured.model_copy(update={"sample_age_s": measured.sample_age_s + age_s})
        return cls(
            cell=status.cell,
            state=status.state,
            heartbeat_age_s=age_s,
            last_known_state=status.state,
            can_start=status.can_start,
            why_not=status.why_not,
            latch=status.latch,
            run=status.run,
            measured=measured,
            force_ceiling_n=status.force_ceiling_n,
            recipes=status.recipes,
            driver=status.driver,
            mode=status.mode,
            degradations=(*status.degradations, *own),
            counters=status.counters,
            service_epoch=status.service_epoch,
        )


class StopAnswer(BaseModel):
    """State of the cell when the answer to a stop or reset is sent."""

    cell: str = Field(description="Id of the cell whose control process took the command.")
    confirmed: bool = Field(description="True if standstill of the arm was measured after the command.")
    state: CellState
    measured: Measured | None
    detail: str


class RunPage(BaseModel):
    """Runs, newest first."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"runs": [_RUN_EXAMPLE], "next": None}]})

    runs: list[Run]
    next: str | None = Field(description="Path of the page with older runs; null on the last one.")


class Health(BaseModel):
    """Liveness and readiness of this server."""

    alive: bool = True
    ready: bool = Field(description="True if every check passes.")
    checks: dict[str, str] = Field(description='"ok" or the problem, by name of the check.')


class Frame(Telemetry):
    """One point of the live plot, about 25 a second.

    `force_peak_n` is the largest |F| of all samples since the last frame, so the reduced rate hides no peak.
    """
