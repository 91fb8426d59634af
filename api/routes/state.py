"""Status and health."""

from fastapi import APIRouter, Response

from api.history import HistoryError
from api.models import CellStatus, Health
from api.problems import ProblemError, described
from api.runtime import Runtime, RuntimeDependency
from service.messages import CellState

router = APIRouter(tags=["state"])

FRESH_SAMPLE_S = 0.5


@router.get("/status", operation_id="status", summary="Measured state of the cell", response_model=CellStatus)
async def status(runtime: RuntimeDependency) -> Response:
    """Answer with the control process's last heartbeat, or with UNKNOWN and the heartbeat's age if it is not fresh.

    The answer never reports what was merely commanded.
    """
    # Encoded here: FastAPI would check it once more
    return Response(runtime.status().model_dump_json(), media_type="application/json")


@router.get("/health", operation_id="health", summary="Liveness and the checks of readiness")
async def health(runtime: RuntimeDependency) -> Health:
    """Answer 200 while this server is alive. `ready` and `checks` say whether it can serve an operator."""
    return await _health(runtime)


@router.get("/health/ready", operation_id="ready", summary="Readiness", responses=described(503))
async def ready(runtime: RuntimeDependency) -> Health:
    """Answer 200 if every check passes, else 503 with the names of the failed checks."""
    found = await _health(runtime)
    if not found.ready:
        failed = "; ".join(f"{name}: {text}" for name, text in found.checks.items() if text != "ok")
        raise ProblemError(503, "NOT_READY", failed)
    return found


async def _health(runtime: Runtime) -> Health:
    status = runtime.status()
    checks = {"control_process": "ok", "arm": "ok", "history": "ok"}
    if status.state is CellState.UNKNOWN:
        checks["control_process"] = status.why_not or "silent"
        checks["arm"] = "not known"
    elif status.measured is None:
        checks["arm"] = "no sample yet"
    elif status.mode == "real_time" and status.measured.sample_age_s > FRESH_SAMPLE_S:
        checks["arm"] = f"no sample for {status.measured.sample_age_s:.1f} s"
    checks["events"] = runtime.cell.failure or "ok"
    try:
        await runtime.cell.history.check()
    except HistoryError as error:
        checks["history"] = str(error)
    return Health(ready=all(text == "ok" for text in checks.values()), checks=checks)
