"""The cell's events as a stream that a client can leave and later resume."""

import asyncio
from collections import deque
from collections.abc import Generator
from contextlib import contextmanager

from service.messages import Event

EVENTS_HELD = 1024
SUBSCRIBER_QUEUE = 256


def event_id(event: Event) -> str:
    """Return the id that a client returns as `Last-Event-ID`. It stays valid across a restart of the API."""
    return f"{event.service_epoch}.{event.seq}"


class Subscription:
    """One client's queue of events. `None` in it tells the reader to send the status now.

    Attributes:
        resumed: False if events after the client's last one are lost.
        ended: True if the client was too slow or the feed was closed. The client must connect again.
    """

    def __init__(self, backlog: list[Event], resumed: bool) -> None:
        self.resumed = resumed
        self.ended = False
        self._queue: asyncio.Queue[Event | None] = asyncio.Queue(SUBSCRIBER_QUEUE + EVENTS_HELD)
        for event in backlog:
            self._queue.put_nowait(event)

    async def next(self, timeout_s: float) -> Event | None:
        """Return the next event; None when the status changed or the feed ended.

        Raises:
            TimeoutError: neither came within `timeout_s`.
        """
        async with asyncio.timeout(timeout_s):
            return await self._queue.get()

    def offer(self, event: Event | None) -> None:
        try:
            self._queue.put_nowait(event)
        except asyncio.QueueFull:
            self.end()

    def end(self) -> None:
        self.ended = True
        if self._queue.empty():
            self._queue.put_nowait(None)


class EventFeed:
    """Holds the newest events and hands new ones to every subscriber."""

    def __init__(self) -> None:
        self._held: deque[Event] = deque(maxlen=EVENTS_HELD)
        self._subscriptions: set[Subscription] = set()
        self._closed = False

    def publish(self, event: Event) -> None:
        self._held.append(event)
        for subscription in self._subscriptions:
            subscription.offer(event)

    def nudge(self) -> None:
        """Make every subscriber send the status now."""
        for subscription in self._subscriptions:
            subscription.offer(None)

    def close(self) -> None:
        """End every subscription, present and future."""
        self._closed = True
        for subscription in self._subscriptions:
            subscription.end()

    @contextmanager
    def subscribe(self, last_event_id: str | None = None, replay: int = 0) -> Generator[Subscription]:
        """Subscribe from after `last_event_id` on; without that id, from the newest `replay` events on."""
        held = list(self._held)
        backlog = held[max(0, len(held) - replay) :]
        resumed = True
        if last_event_id is not None:
            known = [index for index, event in enumerate(held) if event_id(event) == last_event_id]
            resumed = bool(known)
            backlog = held[known[-1] + 1 :] if known else held
        subscription = Subscription(backlog, resumed)
        self._subscriptions.add(subscription)
        if self._closed:
            subscription.end()
        try:
            yield subscription
        finally:
            self._subscriptions.discard(subscription)
