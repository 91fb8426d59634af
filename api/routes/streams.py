"""Server-sent events: the journal with the status, and the points of the live plot."""

import asyncio
from collections.abc import AsyncIterator
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
) -> AsyncIterator[ServerSentEvent]:
    """Stream `event` (an `Event`, with id), `status` (a `CellStatus`, at least four a second) and `resync`.

    `resync` means that events after `Last-Event-ID` are lost: read `GET /runs` again.
    """
    with runtime.cell.feed.subscribe(last_event_id, replay) as subscription:
        yield ServerSentEvent(event="status", data=runtime.status(), retry=RECONNECT_MS)
        if not subscription.resumed:
            yield ServerSentEvent(event="resync", data={"last_event_id": last_event_id})
        while not (subscription.ended or runtime.closing.is_set()):
            event = await subscription.next(STATUS_PERIOD_S)
            if event is None:
                yield ServerSentEvent(event="status", data=runtime.status())
            else:
                yield ServerSentEvent(event="event", id=event_id(event), data=event)


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
