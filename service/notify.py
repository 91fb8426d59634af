"""Notices to systemd about the state of this process, as `sd_notify(3)` describes them.

Without systemd, or in a unit that wants no notices, nothing is sent.
"""

import contextlib
import os
import socket
import time
from collections.abc import Mapping
from typing import Self

PER_PERIOD = 4
"""Signs of life in each of systemd's periods."""


class Notifier:
    """Sends notices. It neither blocks nor raises.

    Args:
        environment: variables that systemd has set: `NOTIFY_SOCKET`, and with a watchdog `WATCHDOG_USEC` and
            `WATCHDOG_PID`.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) if address else None
        if self._socket is not None:
            self._socket.setblocking(False)
        meant = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self._period_s = int(environment.get("WATCHDOG_USEC", "0")) * 1e-6 / PER_PERIOD if meant else 0.0
        self._next_s = 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._socket is not None:
            self._socket.close()

    def send(self, state: str) -> None:
        """Send a notice, such as `READY=1`."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(state.encode(), self._address)

    def beat(self) -> None:
        """Send a sign of life where one is due."""
        now = time.monotonic()
        if self._period_s > 0.0 and now >= self._next_s:
            self._next_s = now + self._period_s
            self.send("WATCHDOG=1")
