"""Driver of a Universal Robots e-Series arm, real or emulated: RTDE, the control program, and the dashboard.

The law, the ceiling and the watchdogs run in `control_program.urscript` on the controller. The driver sends targets,
makes samples of the returned data, and carries out an operator's requests through the dashboard.
"""

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable

import structlog

from service.config import CellConfig, UrSection
from service.drivers.base import DriverError, PoseTarget, SampleSink
from service.drivers.camera import Camera
from service.drivers.ur import gate, recovery
from service.drivers.ur.dashboard import DashboardError
from service.drivers.ur.link import UrLink
from service.drivers.ur.program import ProgramError, render
from service.drivers.ur.registers import Command
from service.drivers.ur.samples import Package, SampleReader
from service.drivers.world_setup import WorldSetup
from service.faults import FaultCode
from wire.law import ComplianceLaw, ControlLimits
from wire.modes import TimeMode
from wire.records import TICK_S, Program
from wire.rtde.modes import RuntimeState
from wire.task import Task

FRESH_S = 1.0
"""Robot's time within which samples and camera frames of a newly laid out world must arrive, s."""
ESCALATE_S = 1.0
"""Time within which standstill must be measured after a program was ended, s; else the arm's power is cut."""
REST_S = 0.1
"""Uninterrupted rest required, s: a swinging arm is momentarily slow at each reversal."""
ERRAND_S = 1.0
"""Host time for one dashboard command in an escalation, s; a hanging command must not delay the next."""
FOREIGN_S = 0.5
"""Time for which a program that is not ours must play, robot's time, s; ours needs some steps to be recognised."""
POLL_S = 0.01
ECHO_MARGIN_S = 0.02
"""Allowance for the controller's own steps between an order and its echo, s."""
STANDSTILL_RAD_S = 0.02
"""Speed of the fastest joint below which the arm stands."""

_log = structlog.get_logger("service.drivers")


class UrDriver:
    """One e-Series arm.

    Args:
        config: configuration of the cell, with a `ur` section.
        mode: `lockstep` if somebody else advances an emulated controller; time is then the controller's own.
        clock: returns monotonic time of the host, s, in real time.
        camera: reports the position of the hole; None without a camera.
        world_setup: lays out the world of an emulated controller; None for a real arm.

    Attributes:
        checks: result of the last start-up gate.

    Raises:
        ProgramError: the configuration yields no control program.
    """

    tick_s = TICK_S
    samples_dropped = 0

    def __init__(
        self,
        config: CellConfig,
        *,
        mode: TimeMode = "real_time",
        clock: Callable[[], float] = time.monotonic,
        camera: Camera | None = None,
        world_setup: WorldSetup | None = None,
    ) -> None:
        if config.ur is None:
            raise ProgramError("the configuration has no [ur] section")
        self.mode: TimeMode = mode
        self.name = f"{'emulated ' if config.ur.simulated else ''}UR controller at {config.ur.host}"
        self.simulated = world_setup is not None
        self.checks: tuple[gate.Check, ...] = ()
        self._ur = config.ur
        self._preflight = config.preflight
        self._host_clock = clock
        self._camera = camera
        self._world_setup = world_setup
        self._reader = SampleReader(config.ur)
        # there and back, each way with the delay that a sample may have
        echo_s = 2.0 * config.limits.sample_age_s + ECHO_MARGIN_S
        self._link = UrLink(config.ur, render(config), mode, clock, self._take, self._lose, echo_s)
        self._sink: SampleSink | None = None
        self._episode = 0
        self._proven = not (config.ur.simulated if config.ur.prove_watchdog is None else config.ur.prove_watchdog)
        self._setting: tuple[float, tuple[float, ...], tuple[float, ...]] | None = None
        self._preparing = False
        self._ours_s = 0.0
        self._unlocking: asyncio.Task[None] | None = None
        self._escalation: asyncio.Task[None] | None = None

    @property
    def clock(self) -> Callable[[], float]:
        return (lambda: self._link.arrival_s) if self.mode == "lockstep" else self._host_clock

    @property
    def received_s(self) -> float | None:
        """Robot's time stamp of the newest package, None without one; whoever advances a controller waits for it."""
        package = self._link.package
        return None if package is None else package.time_s

    async def connect(self, sink: SampleSink) -> None:
        """Connect to the controller, run the gate as far as the arm's state allows, and start the samples.

        An arm that is switched off, stopped or in local control is connected too: its samples report the state, and
        `prepare` refuses it.

        Raises:
            DriverError: the controller cannot be reached or cannot run the control program, or its watchdog does not
                work.
        """
        self._sink = None
        self._episode = 0
        for helper in (self._camera, self._world_setup):
            if helper is not None:
                await helper.open()
        await self._link.open()
        facts = await gate.measure(self._link, self._ur, self._preflight, prove_watchdog=not self._proven)
        self.checks = gate.judge(facts, self._ur, self._preflight)
        for check in gate.failures(self.checks):
            _log.warning("gate", check=check.name, measured=check.measured, remedy=check.remedy)
            if check.name in gate.UNSAFE:
                raise DriverError(FaultCode.PROTOCOL, f"{self.name}: {check.text}")
        self._proven = self._proven or facts.watchdog_s is not None
        self._sink = sink

    async def prepare(self, task: Task | None) -> None:
        """Have the arm ready and the control program running, and lay out a simulated world.

        The gate runs again: at the time of the connection the arm may have had no power, so the earlier results may no
        longer hold. A tool that carries a load gets no control program, because its start would zero the load away; in
        a simulated world the layout frees the tool.

        Raises:
            DriverError: AUTHORITY, the arm is not ours to move; CONTACT_AT_START, the tool carries a load; PROTOCOL, a
                seed for a real arm.
        """
        if self._world_setup is None and task is not None:
            raise DriverError(FaultCode.PROTOCOL, f"{self.name} is real and has no seed: leave it out")
        self._preparing = True  # the program is ended and started meanwhile
        try:
            facts = await gate.measure(
                self._link,
                self._ur,
                self._preflight,
                prove_watchdog=not self._proven,
                load=self._world_setup is None and not self._link.watch.running,
            )
        finally:
            self._preparing = False
        for code, checks in (
            (FaultCode.AUTHORITY, gate.judge_program(facts, self._ur)),
            (FaultCode.CONTACT_AT_START, gate.judge_load(facts, self._ur, self._preflight)),
        ):
            if failed := gate.failures(checks):
                raise DriverError(code, "; ".join(check.text for check in failed))
            self._note(checks)
        self._proven = self._proven or facts.watchdog_s is not None
        if self._world_setup is not None:
            await self._lay_out(self._world_setup, task)

    def engage(self, law: ComplianceLaw, limits: ControlLimits) -> None:
        self._link.outbox.put(
            Command.ENGAGE,
            (
                *law.stiffness,
                *law.damping,
                *law.inertia,
                *limits.max_speed,
                *limits.max_step,
                limits.force_ceiling_n,
                limits.target_age_s,
            ),
        )

    def send_target(self, target: PoseTarget) -> int:
        return self._link.outbox.put(Command.TARGET, (*target.position.tolist(), *target.rotvec.tolist()))

    def stop(self) -> None:
        self._link.outbox.stop()

    def stop_blind(self) -> None:
        self._link.outbox.stop(blind=True)

    def zero_ft(self) -> None:
        self._link.outbox.put(Command.ZERO_FT)

    def unlock(self) -> None:
        if self._unlocking is None or self._unlocking.done():
            self._unlocking = asyncio.create_task(self._unlock(), name="unlock")

    def escalate(self) -> None:
        self.stop()
        if self._escalation is None or self._escalation.done():
            self._escalation = asyncio.create_task(self._escalate(), name="escalate")

    async def close(self) -> None:
        self.stop()
        self._sink = None
        errands = [task for task in (self._unlocking, self._escalation) if task is not None]
        await asyncio.gather(*errands, return_exceptions=True)
        await self._link.close()
        for helper in (self._camera, self._world_setup):
            if helper is not None:
                await helper.close()

    async def _lay_out(self, world_setup: WorldSetup, task: Task | None) -> None:
        """Lay out the world as the last step before a run, so that nothing changes the seed's world in between."""
        self._episode = 0  # samples of the old world end here
        laid_out = await world_setup.lay_out(task)
        camera = self._camera

        def is_shown(package: Package) -> bool:
            seen = camera is None or camera.episode == laid_out.episode
            return 0.0 < package.time_s - laid_out.time_s < 2.0 * FRESH_S and seen

        if not await self._link.until(is_shown, FRESH_S):
            text = f"{self.name}: no samples, or no camera frames, of the world that was laid out; is it another arm's?"
            raise DriverError(FaultCode.STALE, text)
        self._link.resynchronise()  # the controller's clock stood still during the layout
        self._episode = laid_out.episode

    # --- what arrives

    def _take(self, package: Package, arrival_s: float) -> None:
        sink, camera = self._sink, self._camera
        if sink is None:
            return
        if package.program == Program.ENGAGED and self._link.watch.running:
            self._judge_setting(package, sink)
        self._judge_program(package, sink)
        if self._episode and camera is not None and camera.episode != self._episode:
            sink.on_link_fault(FaultCode.SOURCE, f"{self.name}: another client laid out the world")
            self._episode = 0
        estimate = None if camera is None else camera.estimate(self.clock())
        try:
            sample = self._reader.read(
                package,
                arrival_s,
                running=self._link.watch.running,
                episode=self._episode,
                hole_estimate=estimate,
            )
        except ValueError as error:
            sink.on_link_fault(FaultCode.PROTOCOL, f"{self.name}: {error}: who writes registers 24 to 47?")
        else:
            sink.on_sample(sample)

    def _judge_setting(self, package: Package, sink: SampleSink) -> None:
        """Report a change of the values with which the law was engaged; others can set them while the program runs."""
        text = ""
        if not package.speed_fraction >= gate.MIN_SPEED_FRACTION:
            text = f"the speed slider was moved to {package.speed_fraction:.0%}"
        elif (setting := (package.payload_kg, package.payload_com, package.tcp_offset)) != self._setting:
            failed = gate.tool_failures(package, self._ur)
            if failed:
                text = "; ".join(check.text for check in failed)
            else:
                self._setting = setting
        if text:
            sink.on_link_fault(FaultCode.AUTHORITY, f"{self.name}: {text}")

    def _judge_program(self, package: Package, sink: SampleSink) -> None:
        """Report a program that plays on the controller and is not ours; ours counts a moment after it was started."""
        if self._preparing or self._link.watch.running or package.runtime_state != RuntimeState.PLAYING:
            self._ours_s = package.time_s
        elif package.time_s - self._ours_s > FOREIGN_S:
            self._ours_s = package.time_s
            text = "a program plays on the controller that is not this cell's, or that hangs"
            sink.on_link_fault(FaultCode.AUTHORITY, f"{self.name}: {text}")

    def _note(self, checks: tuple[gate.Check, ...]) -> None:
        """Store the checks made now and keep earlier results of the checks skipped now."""
        found = {check.name: check for check in checks if check.verdict is not gate.Verdict.SKIPPED}
        self.checks = tuple(found.get(check.name, check) for check in self.checks)

    def _lose(self, code: FaultCode, text: str) -> None:
        if self._sink is not None:
            self._sink.on_link_fault(code, text)

    # --- errands to the dashboard

    async def _unlock(self) -> None:
        try:
            await recovery.unlock(self._ur)
        except DashboardError as error:
            _log.warning("unlock", error=str(error))

    async def _escalate(self) -> None:
        """End the program; if standstill is not measured afterwards, cut the arm's power.

        A program that has not obeyed a stop is no longer kept alive: without words from the driver the watchdog ends
        it, even if the dashboard is unreachable.
        """
        _log.error("escalate", what="no standstill was measured: the program is ended")
        with self._link.silence():
            await self._last_resort(recovery.stop_program)
            rests = await self._comes_to_rest()
        if rests:
            return
        if await self._last_resort(recovery.power_off):
            _log.error("escalate", what="the arm's power was cut")

    async def _last_resort(self, errand: Callable[[UrSection], Awaitable[None]]) -> bool:
        """Run one errand; return True if it was done. A failure must not keep the next errand from running."""
        try:
            async with asyncio.timeout(ERRAND_S):
                await errand(self._ur)
        except Exception as error:
            _log.error("escalate", error=f"{type(error).__name__}: {error}")
            return False
        return True

    async def _comes_to_rest(self) -> bool:
        """Return True once the arm is measured to stand for a while, with no program that could move it."""
        end_s = self.clock() + ESCALATE_S
        still_since: float | None = None
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(2.0 * ESCALATE_S):  # in lockstep without a link, no time passes
                while self.clock() < end_s:
                    package = self._link.package
                    if package is None or not _rests(package):
                        still_since = None
                    elif still_since is None:
                        still_since = package.time_s
                    elif package.time_s - still_since >= REST_S:
                        return True
                    await asyncio.sleep(POLL_S)
        return False


def _rests(package: Package) -> bool:
    """Return True for an arm at rest; written so that a speed that is not a number counts as motion."""
    return package.runtime_state == RuntimeState.STOPPED and all(abs(speed) < STANDSTILL_RAD_S for speed in package.qd)
