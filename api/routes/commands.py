"""Start, stop and reset."""

import asyncio
from typing import Annotated

import structlog
from fastapi import APIRouter, Header, Request, Response

from api.history import HistoryError
from api.models import ResetBody, StartBody, StopAnswer
from api.problems import SILENT_TEXT, ProblemError, described
from api.receipt import Receipt
from api.runtime import RuntimeDependency, runtime_of
from api.stop_rule import OPERATOR_LENGTH, asked_by
from service.client import CellSilentError
from service.messages import CellState, ResetRequest, Run, StartRequest, StopRequest
from service.stopping import WITHIN_S, confirm, deliver, is_standing

router = APIRouter(tags=["commands"])
_log = structlog.get_logger("api.commands")

NOT_CONFIRMED_TEXT = (
    "NOT CONFIRMED: the control process has the stop, but standstill is not measured within a second. "
    "If the robot moves, use the robot's own emergency stop."
)
STOP_SILENT_TEXT = f"NOT CONFIRMED: the stop was not delivered. {SILENT_TEXT}"
STOPPED_TEXT = "A stop came after this start had been received: look at the cell, then start again, under a new key."


@router.post(
    "/start",
    operation_id="start",
    summary="Request one insertion",
    status_code=202,
    response_model=Run,
    responses={202: {"description": "Accepted; follow the run at `Location`."}, **described(409, 413, 422, 503)},
)
async def start(
    body: StartBody,
    request: Request,
    response: Response,
    runtime: RuntimeDependency,
    idempotency_key: Annotated[
        str | None,
        Header(
            min_length=1,
            max_length=128,
            pattern=r"^[\x21-\x7e]+$",
            description="A repeated key is answered with the same run and starts nothing. With a key, a start whose "
            "answer was lost can be repeated safely.",
            examples=["5e0f6a2e-8a3b-4a60-9c5f-0c6f3c1f1b1a"],
        ),
    ] = None,
) -> Run:
    """Answer 202 with the run once the cell has accepted it, or 409 with the fault's code if its state forbids a start.

    A stop that comes before the answer wins: the start is refused with `STOPPED`, or its run is stopped.

    The run continues on its own: follow it with `GET /runs/{id}`, `GET /status` or `GET /events`.
    """
    receipt: Receipt = request.state.receipt
    after = runtime.cell.first_marks.of(idempotency_key, receipt.mark)
    if runtime.cell.is_silent:
        raise ProblemError(503, "CELL_SILENT", runtime.status().why_not or SILENT_TEXT, state=CellState.UNKNOWN)
    try:
        await runtime.cell.history.check()
    except HistoryError as error:
        raise ProblemError(503, "STORAGE", str(error)) from error
    if await request.is_disconnected():
        raise ProblemError(503, "EXPIRED", "The client gave up before the start was sent to the control process.")
    if receipt.stops_asked != runtime.cell.stops_asked:
        raise ProblemError(409, "STOPPED", STOPPED_TEXT)
    start_request = StartRequest(
        recipe=body.recipe,
        seed=body.seed,
        idempotency_key=idempotency_key,
        requested_by=body.operator or "api",
        after=after,
    )
    try:
        result = await runtime.unless_closing(runtime.cell.client.start(start_request))
    except CellSilentError as error:
        raise ProblemError(
            503,
            "CELL_SILENT",
            "The control process did not answer in time. It is not known whether it accepted the start: see "
            "GET /status, or repeat the request with the same Idempotency-Key.",
            state=CellState.UNKNOWN,
        ) from error
    run = result.run
    if not result.created and (run.recipe != body.recipe or body.seed not in {None, run.seed}):
        raise ProblemError(
            422,
            "IDEMPOTENCY_KEY_REUSED",
            f"This Idempotency-Key belongs to run {run.id} of another request; use a new key for a new run.",
            field="header.Idempotency-Key",
        )
    runtime.cell.history.put(run)
    response.headers["Location"] = f"/runs/{run.id}"
    if not result.created:
        response.headers["Idempotency-Replayed"] = "true"
    return run


@router.post(
    "/stop",
    operation_id="stop",
    summary="Stop all motion",
    response_model=StopAnswer,
    responses={
        200: {"description": "Standstill of the arm was measured after the stop command."},
        202: {"model": StopAnswer, "description": "The control process has the stop; standstill is NOT CONFIRMED."},
        **described(503),
    },
    openapi_extra={
        "parameters": [
            {
                "name": "operator",
                "in": "query",
                "required": False,
                "description": "Name of the person who stops, for the record. No value of it refuses a stop.",
                "schema": {"type": "string", "maxLength": OPERATOR_LENGTH},
            }
        ]
    },
)
async def stop(request: Request, response: Response) -> StopAnswer:
    """Stop now. A stop is accepted in every state, without a body, any number of times, and answered within a second.

    It goes to the control process on a session of its own, ahead of the history and every other request. Only a page
    of another site is refused. This is process protection: it is not the robot's emergency stop and replaces no
    certified safety function.
    """
    runtime = runtime_of(request)
    runtime.cell.stops_asked += 1
    stopper, loop = runtime.cell.stopper, asyncio.get_running_loop()
    deadline = loop.time() + WITHIN_S
    asked = StopRequest(reason="stop over HTTP", requested_by=asked_by(request.scope))
    try:
        told = await deliver(stopper, asked)
    except Exception as error:  # whatever it is, the person who stops must be told what to do
        _log.error("stop not delivered", asked_by=asked.requested_by, error=str(error))
        raise ProblemError(
            503, "STOP_NOT_DELIVERED", STOP_SILENT_TEXT, state=CellState.UNKNOWN, confirmed=False
        ) from error
    runtime.cell.client.heed(told)
    stopped = await confirm(stopper, told, deadline - loop.time())
    status = stopped.status
    _log.warning("stop", confirmed=stopped.confirmed, state=status.state.value, asked_by=asked.requested_by)
    if not stopped.confirmed:
        response.status_code = 202
    return StopAnswer(
        cell=status.cell,
        confirmed=stopped.confirmed,
        state=status.state if stopper.is_alive else CellState.UNKNOWN,
        measured=status.measured,
        detail="standstill is measured" if stopped.confirmed else NOT_CONFIRMED_TEXT,
    )


@router.post(
    "/reset",
    operation_id="reset",
    summary="Acknowledge a latched stop",
    responses=described(409, 413, 422, 503),
)
async def reset(body: ResetBody, runtime: RuntimeDependency) -> StopAnswer:
    """Acknowledge the latched fault after looking at the cell. This moves nothing and resumes no run.

    The answer is 409 if nothing is latched, if the fault in force differs from the acknowledged one, or if the force is
    above the limit.
    """
    if runtime.cell.is_silent:
        raise ProblemError(503, "CELL_SILENT", SILENT_TEXT, state=CellState.UNKNOWN)
    request = ResetRequest(acknowledge=body.acknowledge, comment=body.comment, requested_by=body.operator)
    status = await runtime.unless_closing(runtime.cell.client.reset(request))
    _log.warning("reset", operator=body.operator, comment=body.comment, acknowledge=body.acknowledge)
    return StopAnswer(
        cell=status.cell,
        confirmed=is_standing(status),
        state=status.state,
        measured=status.measured,
        detail="acknowledged; nothing moves",
    )
