"""Estimates of the hole's position, for a driver whose arm does not bring them along."""

import asyncio
import math
import threading
from collections.abc import Callable
from typing import Protocol

import numpy as np
import structlog
import zenoh

from wire import records as wire
from wire.arrays import FloatArray
from wire.session import close_session, open_session

_log = structlog.get_logger("service.drivers")


class Camera(Protocol):
    """Whatever knows where the hole is."""

    @property
    def episode(self) -> int:
        """How often the simulated world that it looks at was laid out; 0 for a real one, or before the first frame."""
        ...

    async def open(self) -> None:
        """Let frames come; may be called again.

        Raises:
            OSError: there is no way to the camera.
        """
        ...

    def estimate(self, now: float) -> FloatArray | None:
        """(3,) centre of the hole's mouth, base frame, m; None without one that is fresh.

        Args:
            now: by the driver's clock.
        """
        ...

    async def close(self) -> None:
        """Release what it holds."""
        ...


class ZenohCamera:
    """A camera that publishes `wire.CAMERA` records; the newest one counts, as long as it is fresh.

    A frame that comes again, or after a newer one, refreshes nothing: a camera that hangs behind a publisher that does
    not is as good as none. One of a world laid out anew is the first. Two publishers at once, by their `epoch`, are
    none: one of them may look at another cell.

    Args:
        endpoint: of the publisher.
        key: under which it publishes.
        max_age_s: an older estimate is none.
        clock: monotonic seconds of the host.
    """

    def __init__(self, endpoint: str, key: str, max_age_s: float, clock: Callable[[], float]) -> None:
        self._endpoint = endpoint
        self._key = key
        self._max_age_s = max_age_s
        self._clock = clock
        self._lock = threading.Lock()
        self._newest: tuple[float, FloatArray] | None = None
        self._episode = self._epoch = 0
        self._time_s = self._heard_s = self._rival_s = -math.inf
        self._told = False
        self._session: zenoh.Session | None = None

    @property
    def episode(self) -> int:
        return self._episode

    async def open(self) -> None:
        if self._session is None:
            self._session = await asyncio.to_thread(open_session, connect=[self._endpoint])
            self._session.declare_subscriber(self._key, self._receive)

    def estimate(self, now: float) -> FloatArray | None:
        with self._lock:
            newest, rival_s = self._newest, self._rival_s
        if newest is None or now - rival_s <= self._max_age_s or now - newest[0] > self._max_age_s:
            return None
        return newest[1]

    async def close(self) -> None:
        session, self._session = self._session, None
        if session is not None:
            await asyncio.to_thread(close_session, session)

    def _receive(self, message: zenoh.Sample) -> None:
        """On Zenoh's thread."""
        arrival_s = self._clock()
        try:
            records = wire.decode(message.payload.to_bytes(), wire.CAMERA)
        except wire.WireError as error:
            if not self._told:  # once: the next frame is a fortieth of a second away
                _log.error("camera", key=self._key, error=str(error))
            self._told = True
            return
        row = records[-1]
        position = np.array(row["position"], np.float64)
        epoch, episode, time_s = int(row["epoch"]), int(row["episode"]), float(row["time_s"])
        with self._lock:
            if epoch != self._epoch and arrival_s - self._heard_s <= self._max_age_s:
                self._rival_s = arrival_s
                return
            self._heard_s = arrival_s
            if (epoch, episode) == (self._epoch, self._episode) and not time_s > self._time_s:
                return
            self._epoch, self._episode, self._time_s = epoch, episode, time_s
            self._newest = (arrival_s, position) if bool(np.isfinite(position).all()) else None
