import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import aclosing, asynccontextmanager
from typing import Any

from service.messages import CellState, EventKind
from tests.api.wire_cell import RECIPE, Api, WireCell, until


async def parsed(lines: AsyncIterator[str]) -> AsyncIterator[dict[str, Any]]:
    """Yield the messages of an event stream: event, id, data."""
    message: dict[str, Any] = {}
    async for line in lines:
        name, _, value = line.partition(": ")
        if name in {"event", "id", "data"}:
            message[name] = value
        elif not line and message:
            if "data" in message:
                yield message | {"data": json.loads(message["data"])}
            message = {}


@asynccontextmanager
async def stream(api: Api, path: str, **headers: str) -> AsyncIterator[AsyncIterator[dict[str, Any]]]:
    async with api.http.stream("GET", path, headers=headers) as response:
        assert response.headers["content-type"].startswith("text/event-stream")
        async with aclosing(parsed(response.aiter_lines())) as messages:
            yield messages


async def next_of(messages: AsyncIterator[dict[str, Any]], event: str) -> dict[str, Any]:
    async with asyncio.timeout(15):
        async for message in messages:
            if message["event"] == event:
                return message
    raise AssertionError(f"the stream ended without {event}")


async def test_a_stream_of_events_begins_with_the_status(api: Api) -> None:
    async with stream(api, "/events") as messages:
        first = await anext(messages)
        assert first["event"] == "status"
        assert first["data"]["state"] == "READY"


async def test_events_come_with_ids_and_are_taken_up_where_they_were_left(api: Api, cell: WireCell) -> None:
    async with stream(api, "/events") as messages:
        await anext(messages)
        cell.tell(EventKind.WARNING, "one")
        one = await next_of(messages, "event")
    assert one["data"]["text"] == "one"
    assert one["id"] == "e1.1"
    for text in ("two", "three"):
        cell.tell(EventKind.WARNING, text)
    await until(lambda: len(api.held_events) == 3)
    async with stream(api, "/events", **{"Last-Event-ID": one["id"]}) as messages:
        texts = [(await next_of(messages, "event"))["data"]["text"] for _ in range(2)]
    assert texts == ["two", "three"]


async def test_a_new_client_may_begin_with_the_newest_events(api: Api, cell: WireCell) -> None:
    for text in ("one", "two", "three"):
        cell.tell(EventKind.WARNING, text)
    await until(lambda: len(api.held_events) == 3)
    async with stream(api, "/events?replay=2") as messages:
        texts = [(await next_of(messages, "event"))["data"]["text"] for _ in range(2)]
    assert texts == ["two", "three"]


async def test_a_client_is_told_when_events_were_lost_to_it(api: Api) -> None:
    async with stream(api, "/events", **{"Last-Event-ID": "e0.999"}) as messages:
        assert (await next_of(messages, "resync"))["data"] == {"last_event_id": "e0.999"}


async def test_a_change_of_state_is_told_to_every_stream(api: Api) -> None:
    async with stream(api, "/events") as one, stream(api, "/events") as other:
        await api.http.post("/start", json={"recipe": RECIPE})
        for messages in (one, other):
            while (await next_of(messages, "status"))["data"]["state"] != "RUNNING":
                pass


async def test_an_idle_stream_goes_on_telling_the_status_and_then_that_it_is_unknown(api: Api, cell: WireCell) -> None:
    async with stream(api, "/events") as messages:
        for _ in range(4):
            await next_of(messages, "status")
        cell.heartbeat = False
        while (status := (await next_of(messages, "status"))["data"])["state"] != "UNKNOWN":
            pass
        assert status["heartbeat_age_s"] >= 0.5


async def test_telemetry_is_thinned_out_without_hiding_a_peak(api: Api, cell: WireCell) -> None:
    async with stream(api, "/telemetry") as messages:
        await asyncio.sleep(0.1)
        for index in range(50):
            cell.trace(t=0.002 * index, force_n=1.0, peak_n=29.0 if index == 20 else None)
        cell.trace(t=1.0, force_n=-2.0)
        frames = []
        while not frames or frames[-1]["t"] < 1.0:
            frames.append((await next_of(messages, "frame"))["data"])
    assert len(frames) < 51
    assert max(frame["force_peak_n"] for frame in frames) == 29.0
    assert frames[-1]["force_n"][2] == -2.0
    assert frames[-1]["z_lock_m"] == 0.099


async def test_a_client_that_leaves_is_forgotten(api: Api) -> None:
    async with stream(api, "/events") as messages:
        await anext(messages)
        assert api.subscribers == 1
    await until(lambda: api.subscribers == 0)


async def test_streams_end_when_the_server_is_told_to(api: Api) -> None:
    async with stream(api, "/events") as events, stream(api, "/telemetry") as frames:
        await anext(events)
        api.close_streams()
        async with asyncio.timeout(15):
            async for _ in events:
                pass
            async for _ in frames:
                pass
    assert (await api.http.get("/status")).json()["state"] == CellState.READY
