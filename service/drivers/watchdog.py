"""The watchdog of a control process: a process of its own that stops the arm when the control loop falls silent.

The loop sends one byte a turn through a pipe. While a run is under way, a silence longer than the limit stops the arm
through a connection of the watchdog's own, and so does the end of the pipe: the control process hangs or was killed.
Through a second pipe the watchdog says that it is ready.
`python -m service.drivers.watchdog` is the process; `Watchdog` is the loop's side.
"""

import contextlib
import fcntl
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, Self

import zenoh

from service.drivers.sim_wire import BRAKE_WORD, CommandWriter
from service.logs import log_writer
from wire import keys
from wire.session import open_session
from wire.tls import Certificates

REPEAT_S = 0.05
"""Time between two stops, s."""
LAST_STOPS = 20
"""Stops after the end of the pipe; a command may be lost."""
CONNECT_S = 0.25
WORD_VARIABLE = "DSL_ASSEMBLY_BRAKE_WORD"
"""Environment variable with the word under which a simulated world obeys the watchdog."""
_IDLE, _ARMED, _READY = b"\0", b"\1", b"\2"
UNREAD_BEATS = 4096
"""Beats that wait for a watchdog which does not read; the loop's turns of 20 s in a run."""
IDLE_TURNS = 20
"""Turns without a run of which the watchdog is told one. It waits for none of them: they show whether it is there."""


class Brake(Protocol):
    """A way to stop the arm. It may block for some tenths of a second, and never raises."""

    def stop(self) -> None: ...


class ZenohBrake:
    """Stops a simulated cell by a session of its own.

    Args:
        world: name of the world in its keys.
        endpoint: of its server.
        *files: of the certificates, where the endpoint is encrypted.
    """

    def __init__(self, world: str, endpoint: str, *files: str) -> None:
        self._commands = CommandWriter()
        self._commands.client = int(os.environ[WORD_VARIABLE])
        certificates = Certificates(*map(Path, files)) if files else None
        self._session = open_session((), [endpoint], certificates)  # closed as soon as nobody refers to it
        self._publisher = self._session.declare_publisher(
            keys.COMMAND.format(world=world),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )

    def stop(self) -> None:
        with contextlib.suppress(zenoh.ZError):
            self._publisher.put(self._commands.stop().tobytes())


class DashboardBrake:
    """Ends the program on a UR controller through its dashboard server.

    Args:
        host: address of the controller.
        port: of its dashboard server.
    """

    def __init__(self, host: str, port: str) -> None:
        self._address = host, int(port)

    def stop(self) -> None:
        with contextlib.suppress(OSError), socket.create_connection(self._address, timeout=CONNECT_S) as connection:
            connection.recv(1024)  # the greeting
            connection.sendall(b"stop\n")
            connection.recv(1024)


_BRAKES = {"zenoh": ZenohBrake, "dashboard": DashboardBrake}


class Watchdog:
    """The control loop's side: keeps the watchdog quiet.

    Args:
        brake: kind of brake, `zenoh` or `dashboard`, and its arguments.
        limit_s: longest silence, s.

    Raises:
        OSError: no process can be made.
    """

    def __init__(self, brake: Sequence[str], limit_s: float) -> None:
        read, self._write = os.pipe()
        self._told, tell = os.pipe()
        for handle in (self._write, self._told):
            os.set_blocking(handle, False)
        if sys.platform == "linux":
            fcntl.fcntl(self._write, fcntl.F_SETPIPE_SZ, UNREAD_BEATS)
        self._idle_turns = 0
        self._is_ready = self._has_ended = False
        self._reads = True
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "service.drivers.watchdog", f"{read},{tell}", str(limit_s), *brake],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                env=os.environ | {WORD_VARIABLE: str(BRAKE_WORD)},  # other users can read arguments
                pass_fds=(read, tell),
                start_new_session=True,  # it outlives this process by some stops
            )
        finally:
            os.close(read)
            os.close(tell)

    @property
    def pid(self) -> int:
        return self._process.pid

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()  # the loop has ended as it should: there is nothing left to watch
        self._process.wait()
        os.close(self._write)
        os.close(self._told)

    @property
    def attends(self) -> bool:
        """True once it is ready to stop the arm, as long as it reads the beats."""
        if not self._is_ready:
            with contextlib.suppress(BlockingIOError):
                self._is_ready = bool(os.read(self._told, 1))
        return self._is_ready and self._reads

    def beat(self, *, armed: bool) -> bool:
        """Tell that the loop turns; return False once the watchdog has ended. It neither blocks nor raises.

        Args:
            armed: a run is under way, so a silence from now on stops the arm.
        """
        idle_turns, self._idle_turns = self._idle_turns, 0 if armed else self._idle_turns + 1
        if self._has_ended or (not armed and idle_turns % IDLE_TURNS):
            return not self._has_ended
        try:
            os.write(self._write, _ARMED if armed else _IDLE)
            self._reads = True
        except BlockingIOError:
            self._reads = False
        except OSError:
            self._has_ended = True
        return not self._has_ended


def guard(handle: int, limit_s: float, brake: Brake) -> None:
    """Stop the arm whenever the beats stop while armed; return at the end of the pipe.

    Args:
        handle: of the pipe.
        limit_s: longest silence, s.
        brake: of the arm.
    """
    armed = tripped = False
    while True:
        patience_s = None if not armed else REPEAT_S if tripped else limit_s
        if not select.select([handle], [], [], patience_s)[0]:
            brake.stop()
            if not tripped:
                _report(f"watchdog: no sign of the control loop for {limit_s:g} s in a run: the arm is stopped")
            tripped = True
        elif beats := os.read(handle, 65_536):
            armed = beats.endswith(_ARMED)
            tripped = False
        else:
            break
    if armed:
        for _ in range(LAST_STOPS):
            brake.stop()
            time.sleep(REPEAT_S)
        _report("watchdog: the control process ended in a run: the arm was stopped")


def _report(text: str) -> None:
    log_writer().put(f"{text}\n")


def main(handles: str, limit_s: str, kind: str, *where: str) -> None:
    """Watch over a control loop.

    Args:
        handles: numbers of the inherited pipes, of the beats and of the answer.
        limit_s: longest silence, s.
        kind: of brake.
        *where: arguments of the brake.
    """
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # it ends after the loop that it watches
    beats, tell = map(int, handles.split(","))
    brake = _BRAKES[kind](*where)
    with contextlib.suppress(OSError):  # the control process has ended meanwhile, as the pipe of the beats says
        os.write(tell, _READY)
    guard(beats, float(limit_s), brake)
    log_writer().drain()
    os._exit(0)  # an unclosed session may hang the interpreter's own exit


if __name__ == "__main__":
    main(*sys.argv[1:])
