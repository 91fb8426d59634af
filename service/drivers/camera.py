"""Cameras that estimate the hole's position, for a driver whose arm delivers no estimate."""

import asyncio
import math
import threading
from collections.abc import Callable
from typing import Protocol

import numpy as np
import structlog
import zenoh

from wire import records
from wire.arrays import FloatArray
from wire.session import close_session, open_session
from wire.tls import Certificates

_log = structlog.get_logger("service.drivers")


class Camera(Protocol):
    """A source of estimates of the hole's position."""

    @property
    def episode(self) -> int:
        """Number of times that the observed simulated world was laid out; 0 without one or before the first frame."""
        ...

    async def open(self) -> None:
        """Connect to the camera; may be called again.

        Raises:
            OSError: the camera cannot be reached.
        """
        ...

    def estimate(self, now: float) -> FloatArray | None:
        """Return the (3,) centre of the hole's mouth, base frame, m; None without a fresh estimate.

        Args:
            now: time on the driver's clock, s.
        """
        ...

    async def close(self) -> None:
        """Release the connection."""
        ...


class ZenohCamera:
    """A camera that publishes `records.CAMERA` records over Zenoh. The newest record counts while it is fresh.

    A repeated or older frame refreshes nothing, so a publisher that repeats the last frame of a hanging camera soon
    counts as no camera. The first frame of a newly laid out world is always taken. Two publishers at once, told apart
    by their `epoch`, give no estimate, because one of them may look at another cell.

    Args:
        endpoint: endpoint of the publisher.
        key: key under which it publishes.
        max_age_s: largest age of an estimate, s; an older one counts as none.
        clock: monotonic clock of the host, s.
        certificates: of this process, for a `tls/` or `quic/` endpoint.
    """

    def __init__(
        self,
        endpoint: str,
        key: str,
        max_age_s: float,
        clock: Callable[[], float],
        certificates: Certificates | None = None,
    ) -> None:
        self._certificates = certificates
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
            self._session = await asyncio.to_thread(open_session, (), [self._endpoint], self._certificates)
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
        """Take in a message. Runs on Zenoh's thread."""
        arrival_s = self._clock()
        if str(message.key_expr) != self._key:
            return  # the camera names its key; a wildcard is somebody else's
        try:
            frames = records.decode(message.payload.to_bytes(), records.CAMERA)
        except records.WireError as error:
            if not self._told:  # only once, because frames follow each other within a fraction of a second
                _log.error("camera", key=self._key, error=str(error))
            self._told = True
            return
        row = frames[-1]
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
