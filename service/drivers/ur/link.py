"""The driver's connection to one controller: packages in, orders out, and the control program sent and watched."""

import asyncio
import contextlib
import time
from collections.abc import Callable, Generator

from service.config import UrSection
from service.drivers.base import DriverError
from service.drivers.ur import registers
from service.drivers.ur.commands import Outbox
from service.drivers.ur.program import ControlProgram
from service.drivers.ur.rtde import RtdeClient
from service.drivers.ur.samples import (
    OUTPUTS,
    ArrivalClock,
    Package,
    ProgramWatch,
)
from service.drivers.ur.script_upload import UploadError, upload
from service.faults import FaultCode
from wire.modes import TimeMode
from wire.records import Program
from wire.rtde.codec import Decoded
from wire.rtde.errors import RtdeError, RtdeErrorReason
from wire.rtde.modes import RuntimeState

RATE_HZ = 500.0
HEARTBEAT_TICKS = 5
"""Samples between two writes of the input registers. A write follows a sample, so a host falls silent if its loop hangs
or if it receives nothing, and the controller's watchdog ends the program.
"""
PROGRAM_START_S = 3.0
"""The controller's time from the upload to the program's first echo, s."""
STOPPED_S = 1.0
"""Robot's time for an arm found engaged to come to rest, with its retract, s."""
PATIENCE_S = 10.0
"""Host time after which a controller whose own time does not pass is given up, s."""

LINK_FAULTS = {
    RtdeErrorReason.IN_USE: FaultCode.AUTHORITY,
    RtdeErrorReason.NOT_FOUND: FaultCode.PROTOCOL,
    RtdeErrorReason.UNREACHABLE: FaultCode.LINK,
    RtdeErrorReason.TIMEOUT: FaultCode.LINK,
    RtdeErrorReason.CLOSED: FaultCode.LINK,
    RtdeErrorReason.REFUSED: FaultCode.LINK,
}
"""Faults of the cell for the reasons of a connection that failed; the others are PROTOCOL."""


class UrLink:
    """One controller.

    Args:
        ur: section of the configuration with the controller's address.
        program: control program that is to run.
        mode: in lockstep, time is the controller's own, counted from its first package.
        clock: returns monotonic time of the host, s.
        on_package: receives each package and its arrival, after `open`.
        on_lost: receives the reason why the connection ended or is not trusted.
        echo_s: longest time from an order to the program's echo of it, robot's time, s.

    Attributes:
        package: newest package.
        arrival_s: arrival of the newest package, by the clock of the mode.
        watch: tells whether the program runs.
        outbox: queue of orders.
    """

    def __init__(
        self,
        ur: UrSection,
        program: ControlProgram,
        mode: TimeMode,
        clock: Callable[[], float],
        on_package: Callable[[Package, float], None],
        on_lost: Callable[[FaultCode, str], None],
        echo_s: float,
    ) -> None:
        self.package: Package | None = None
        self.arrival_s = 0.0
        self.watch = ProgramWatch(program.crc)
        self.outbox = Outbox(self._write)
        self._ur = ur
        self._program = program
        self._lockstep = mode == "lockstep"
        self._on_package = on_package
        self._on_lost = on_lost
        self._echo_s = echo_s
        self._probe: tuple[int, float] | None = None
        self._client = RtdeClient(
            ur.host,
            ur.rtde_port,
            clock=clock,
            on_package=self._take,
            on_lost=self._lose,
            timeout_s=ur.connect_s,
            silence_s=None if self._lockstep else 1.0,
        )
        self._arrivals = ArrivalClock()
        self._arrived = asyncio.Event()
        self._begun_s: float | None = None
        self._last_written_tick = 0
        self._silences = 0

    @property
    def version(self) -> tuple[int, int, int]:
        """Version of PolyScope as the controller reports it; zeros before it was asked."""
        version = self._client.controller_version
        return (0, 0, 0) if version is None else (version.major, version.minor, version.bugfix)

    @property
    def newest(self) -> Package:
        """Newest package.

        Raises:
            DriverError: LINK, there is none.
        """
        if self.package is None:
            raise DriverError(FaultCode.LINK, f"{self._client.name}: no data yet")
        return self.package

    async def open(self) -> None:
        """Connect, agree on recipes and start the data; drops an older connection.

        Raises:
            DriverError: LINK, not reached; AUTHORITY, a register is in use or the arm does not obey a stop; PROTOCOL, a
                variable is missing.
        """
        self.package = None
        self._arrivals = ArrivalClock()
        self.watch.forget()
        try:
            await self._client.connect()
            await self._client.setup(OUTPUTS, RATE_HZ, [registers.INPUT_NAMES])
            await self._client.start()
        except RtdeError as error:
            raise DriverError(LINK_FAULTS.get(error.reason, FaultCode.PROTOCOL), str(error)) from error
        self.outbox.begin(self.newest.handled)
        if await self._is_alive() and self.newest.program == Program.ENGAGED:
            self.outbox.stop()  # nobody drives the arm that an earlier connection engaged
            if not await self.until(lambda new: new.program == Program.IDLE or not self.watch.running, STOPPED_S):
                text = "the arm was found engaged and does not take a stop: stop its program on the pendant"
                raise DriverError(FaultCode.AUTHORITY, text)

    async def close(self) -> None:
        """End the connection; the controller's watchdog then ends the program."""
        await self._client.close()
        self.package = None

    def resynchronise(self) -> None:
        """Treat the next package as just arrived, because the controller's clock has stood still for a while."""
        self._arrivals = ArrivalClock()

    async def until(self, condition: Callable[[Package], bool], limit_s: float) -> bool:
        """Wait for a package that meets `condition`; return True if one came within `limit_s` of the robot's time.

        Raises:
            DriverError: LINK, the connection ended, or no package came for `PATIENCE_S`.
        """
        end_s = self.newest.time_s + limit_s
        patience_s = time.monotonic() + limit_s + PATIENCE_S
        while not condition(self.newest):
            if self.newest.time_s > end_s:
                return False
            self._arrived.clear()
            try:
                async with asyncio.timeout(max(0.0, patience_s - time.monotonic())):
                    await self._arrived.wait()
            except TimeoutError as error:
                raise DriverError(FaultCode.LINK, f"{self._client.name}: no data any more") from error
        return True

    async def run_program(self) -> None:
        """Ensure that the control program runs, sending it if needed; earlier orders are discarded.

        Raises:
            DriverError: AUTHORITY, another program runs or the controller refuses this one; PROTOCOL, it does not
                compile there or does not answer after its start.
        """
        if self.watch.running or await self._is_alive():
            return
        package = self.newest
        if package.runtime_state != RuntimeState.STOPPED:
            text = "another program runs or is paused on the controller: stop it on the pendant, then try again"
            raise DriverError(FaultCode.AUTHORITY, text)
        self.outbox.begin(package.handled)
        self.watch.forget()
        try:
            await upload(self._ur.host, self._ur.primary_port, self._program.text)
        except UploadError as error:
            raise DriverError(FaultCode.AUTHORITY, f"the control program was not started: {error}") from error
        if not await self.until(lambda _: self.watch.running, PROGRAM_START_S):
            newest = self.newest
            text = (
                f"the control program was sent and does not answer: runtime state {newest.runtime_state}, checksum "
                f"{newest.crc}, expected {self._program.crc}"
            )
            raise DriverError(FaultCode.PROTOCOL, text)

    async def exchange(self, limit_s: float) -> float | None:
        """Send an empty order through the registers and back; return its round trip in robot's time, None if lost."""
        begun_s = self.newest.time_s
        number = self.outbox.begin(self.newest.handled)
        if not await self.until(lambda package: package.handled == number, limit_s):
            return None
        return self.newest.time_s - begun_s

    @contextlib.contextmanager
    def silence(self) -> Generator[None]:
        """Write nothing while the context lasts, so that the controller's watchdog ends the program."""
        self._silences += 1
        try:
            yield
        finally:
            self._silences -= 1

    async def trip_watchdog(self, limit_s: float) -> float | None:
        """Fall silent until the program is ended; return the robot's time that it took, None if it never was."""
        begun_s = self.newest.time_s
        with self.silence():
            ended = await self.until(lambda package: package.runtime_state != RuntimeState.PLAYING, limit_s)
            took_s = self.newest.time_s - begun_s
            if ended:
                await self.until(lambda package: package.runtime_state == RuntimeState.STOPPED, limit_s)
        return took_s if ended else None

    async def _is_alive(self) -> bool:
        """Return True once the counter moves on a fresh connection; before that the program does not count as
        running.
        """
        package = self.newest
        if package.runtime_state != RuntimeState.PLAYING or package.crc != self._program.crc:
            return False
        return await self.until(lambda _: self.watch.running, 0.1)

    def _take(self, values: tuple[Decoded, ...], read_s: float) -> None:
        package = self.package = Package.of(values)
        if self._lockstep:
            self._begun_s = package.time_s if self._begun_s is None else self._begun_s
            self.arrival_s = package.time_s - self._begun_s
        else:
            self.arrival_s = self._arrivals.arrival(package.time_s, read_s)
        if self.watch.observe(package):
            self._judge_echo(package)
            self.outbox.observe(package.handled)
        else:
            self._probe = None
        self._on_package(package, self.arrival_s)
        if not 0 <= package.tick - self._last_written_tick < HEARTBEAT_TICKS:
            self.outbox.repeat()
        self._arrived.set()

    def _judge_echo(self, package: Package) -> None:
        """Time one order after another: packages' arrivals do not show a delay that grows slowly."""
        if self._probe is None:
            return
        number, written_s = self._probe
        took_s = package.time_s - written_s
        if package.handled >= number:
            self._probe = None
        elif took_s > self._echo_s:
            self._probe = None
            limit = f"limit {self._echo_s * 1e3:.0f} ms"
            text = f"{self._client.name}: no echo of an order after {took_s * 1e3:.0f} ms, {limit}: the link is slow"
            self._on_lost(FaultCode.STALE, text)

    def _write(self, values: tuple[int | float, ...]) -> None:
        if self._silences or self.package is None:
            return
        if self._probe is None and self.watch.running and values[0] > self.package.handled:
            self._probe = int(values[0]), self.package.time_s
        self._last_written_tick = self.package.tick
        self._client.send(0, values)

    def _lose(self, error: RtdeError) -> None:
        self.package = None
        self._arrived.set()
        self._on_lost(LINK_FAULTS.get(error.reason, FaultCode.PROTOCOL), str(error))
