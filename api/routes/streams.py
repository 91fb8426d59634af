"""Server-sent events: the journal with the status, and the points of the live plot."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import nullcontext
from typing import Annotated

from fastapi import APIRouter, Header, Query
from fastapi.sse import EventSourceResponse, ServerSentEvent

from api.feed import event_id
from api.models import Frame
from api.problems import described
from api.runtime import RuntimeDependency
from service.messages import Telemetry

router = APIRouter(tags=["streams"])

STATUS_PERIOD_S = 0.25
"""A status is sent at least this often, so a client knows within a second that the connection is gone."""
FRAME_PERIOD_S = 0.04
RECONNECT_MS = 500


@router.get(
    "/events",
    operation_id="events",
    summary="Journal and status as they change",
    response_class=EventSourceResponse,
    responses=described(422),
)
async def events(
    runtime: RuntimeDependency,
    last_event_id: Annotated[
        str | None, Header(max_length=128, description="Id of the client's last event; the stream continues after it.")
    ] = None,
    replay: Annotated[
        int, Query(ge=0, le=100, description="Number of newest events to begin with, if no id is given.")
    ] = 0,
    frames: Annotated[bool, Query(description="Also stream the points of `GET /telemetry`.")] = False,
) -> AsyncIterator[ServerSentEvent]:
    """Stream `event` (an `Event`, with id), `status` (a `CellStatus`, at least four a second) and `resync`.

    `resync` means that events after `Last-Event-ID` are lost: read `GET /runs` again. With `frames`, the stream also
    carries `frame`, so that a page needs one connection.
    """
    cell, clock = runtime.cell, asyncio.get_running_loop().time
    period_s = FRAME_PERIOD_S if frames else STATUS_PERIOD_S
    async with cell.client.telemetry() if frames else nullcontext(asyncio.Queue[Telemetry]()) as points:
        with cell.feed.subscribe(last_event_id, replay) as subscription:
            yield ServerSentEvent(event="status", data=runtime.status(), retry=RECONNECT_MS)
            if not subscription.resumed:
                yield ServerSentEvent(event="resync", data={"last_event_id": last_event_id})
            status_at = frame_at = clock()
            while not (subscription.ended or runtime.closing.is_set()):
                is_changed = False
                try:
                    event = await subscription.next(period_s)
                except TimeoutError:
                    pass
                else:
                    if event is not None:
                        yield ServerSentEvent(event="event", id=event_id(event), data=event)
                    is_changed = event is None
                if is_changed or clock() - status_at >= STATUS_PERIOD_S:
                    status_at = clock()
                    yield ServerSentEvent(event="status", data=runtime.status())
                if clock() - frame_at >= FRAME_PERIOD_S and (frame := _newest(points)) is not None:
                    frame_at = clock()
                    yield ServerSentEvent(event="frame", data=frame)


@router.get(
    "/telemetry",
    operation_id="telemetry",
    summary="Points of the live plot, about 25 a second",
    response_class=EventSourceResponse,
)
async def telemetry(runtime: RuntimeDependency) -> AsyncIterator[ServerSentEvent]:
    """Stream `frame` (a `Frame`), but none while the arm is not measured. A slow client skips frames and never lags."""
    async with runtime.cell.client.telemetry() as points:
        yield ServerSentEvent(comment="telemetry", retry=RECONNECT_MS)
        while not runtime.closing.is_set():
            await asyncio.sleep(FRAME_PERIOD_S)
            if (frame := _newest(points)) is not None:
                yield ServerSentEvent(event="frame", data=frame)


def _newest(points: asyncio.Queue[Telemetry]) -> Frame | None:
    """Drain the queue; return its newest point with the largest force of any sample since the last drain."""
    peak_n, newest = 0.0, None
    while not points.empty():
        newest = points.get_nowait()
        peak_n = max(peak_n, newest.force_peak_n)
    return None if newest is None else Frame(**dict(newest.model_copy(update={"force_peak_n": peak_n})))
