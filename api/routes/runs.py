"""The run history."""

from typing import Annotated

from fastapi import APIRouter, Path, Query, Request, Response

from api.history import HistoryError
from api.models import RunPage
from api.problems import ProblemError, described
from api.runtime import RuntimeDependency
from service.messages import Run

router = APIRouter(tags=["runs"])

RunId = Annotated[str, Path(pattern=r"^[A-Za-z0-9][A-Za-z0-9._:-]{0,63}$", examples=["20261122T140312-5f2c"])]


@router.get("/runs", operation_id="list_runs", summary="Runs, newest first", responses=described(404, 422, 503))
async def list_runs(
    request: Request,
    response: Response,
    runtime: RuntimeDependency,
    limit: Annotated[int, Query(ge=1, le=200, description="Largest number of runs on the page.")] = 20,
    before: Annotated[str | None, Query(max_length=64, description="Only runs older than this one.")] = None,
) -> RunPage:
    """Answer with one page. `next` and the `Link` header lead to the page with older runs."""
    try:
        runs = await runtime.cell.history.newest(limit + 1, before)
    except KeyError as error:
        raise ProblemError(404, "UNKNOWN_RUN", f"There is no run {before}.", field="query.before") from error
    except HistoryError as error:
        raise ProblemError(503, "STORAGE", str(error)) from error
    page = [runtime.cell.current(run) for run in runs[:limit]]
    older = f"/runs?limit={limit}&before={page[-1].id}" if len(runs) > limit else None
    if older is not None:
        response.headers["Link"] = f'<{older}>; rel="next"'
    return RunPage(runs=page, next=older)


@router.get("/runs/{run_id}", operation_id="get_run", summary="One run", responses=described(404, 422, 503))
async def get_run(run_id: RunId, runtime: RuntimeDependency) -> Run:
    """Answer with the run as the control process last reported it."""
    try:
        run = await runtime.cell.history.find(run_id)
    except HistoryError as error:
        raise ProblemError(503, "STORAGE", str(error)) from error
    # A run that is not in the history yet is still on its way here, or the control process refuses with UNKNOWN_RUN.
    return await runtime.cell.client.run(run_id) if run is None else runtime.cell.current(run)
