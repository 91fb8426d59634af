"""The driver of a Universal Robots e-Series arm, real or emulated: RTDE, the control program, and the dashboard.

The law, the ceiling and the watchdogs run in `control_program.urscript` on the controller. This side tells it targets,
makes samples of what comes back, and asks an operator's wishes of the dashboard.
"""

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable

import structlog

from service.config import CellConfig, UrSection
from service.drivers.base import DriverError, PoseTarget, SampleSink
from service.drivers.camera import Camera
from service.drivers.stage import Stage
from service.drivers.ur import gate, recovery
from service.drivers.ur.dashboard import DashboardError
from service.drivers.ur.link import UrLink
from service.drivers.ur.program import ProgramError, render
from service.drivers.ur.registers import Command
from service.drivers.ur.samples import Package, SampleReader
from service.faults import FaultCode
from wire.law import ComplianceLaw, ControlLimits
from wire.limits import TimeMode
from wire.records import TICK_S, Program
from wire.rtde.modes import RuntimeState
from wire.task import Task

FRESH_S = 1.0
"""Robot's time in which samples and camera frames of a world that was just laid out must come."""
ESCALATE_S = 1.0
"""Time in which an ended program must be measured to have brought the arm to rest; else its power is cut."""
REST_S = 0.1
"""Of it without a break: an arm that swings is slow for a moment at every turn."""
ERRAND_S = 1.0
"""Host time for one word with the dashboard in an escalation: one that hangs must not hold up the next."""
POLL_S = 0.01
ECHO_MARGIN_S = 0.02
"""For the controller's own steps between an order and its echo."""
STANDSTILL_RAD_S = 0.02
"""Of the fastest joint: below it the arm stands."""

_log = structlog.get_logger("service.drivers")


class UrDriver:
    """One e-Series arm.

    Args:
        config: of the cell, with a `ur` section.
        mode: `lockstep` where somebody else advances an emulated controller: time is then the controller's own.
        clock: monotonic seconds of the host, in real time.
        camera: says where the hole is; None where nobody does.
        stage: lays out the world of an emulated controller; None for a real arm.

    Attributes:
        checks: what the last start-up gate found.

    Raises:
        ProgramError: no control program can be made of the configuration.
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
        stage: Stage | None = None,
    ) -> None:
        if config.ur is None:
            raise ProgramError("the configuration has no [ur] section")
        self.mode: TimeMode = mode
        self.name = f"{'emulated ' if config.ur.simulated else ''}UR controller at {config.ur.host}"
        self.simulated = stage is not None
        self.checks: tuple[gate.Check, ...] = ()
        self._ur = config.ur
        self._preflight = config.preflight
        self._host_clock = clock
        self._camera = camera
        self._stage = stage
        self._reader = SampleReader(config.ur)
        # there and back, each way as late as a sample may be
        echo_s = 2.0 * config.limits.sample_age_s + ECHO_MARGIN_S
        self._link = UrLink(config.ur, render(config), mode, clock, self._take, self._lose, echo_s)
        self._sink: SampleSink | None = None
        self._episode = 0
        self._proven = not (config.ur.simulated if config.ur.prove_watchdog is None else config.ur.prove_watchdog)
        self._setting: tuple[float, tuple[float, ...], tuple[float, ...]] | None = None
        self._unlocking: asyncio.Task[None] | None = None
        self._escalation: asyncio.Task[None] | None = None

    @property
    def clock(self) -> Callable[[], float]:
        return (lambda: self._link.arrival_s) if self.mode == "lockstep" else self._host_clock

    @property
    def received_s(self) -> float | None:
        """The robot's time stamp of the newest package, None without one: who advances a controller waits for it."""
        package = self._link.package
        return None if package is None else package.time_s

    async def connect(self, sink: SampleSink) -> None:
        """Reach the controller, pass the gate as far as the arm's state lets it, and let samples flow.

        An arm that is switched off, stopped or in local control is connected all the same: its samples say so, and
        `prepare` refuses it.

        Raises:
            DriverError: the controller cannot be reached or cannot run the control program, or its watchdog does not
                work.
        """
        self._sink = None
        self._episode = 0
        for helper in (self._camera, self._stage):
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

        The gate is passed again, but for the sensor, which the run judges itself: when the connection was made the arm
        may have had no power, and what was found then need not hold any more.

        Raises:
            DriverError: AUTHORITY, the arm is not ours to move; PROTOCOL, a seed for a real arm.
        """
        if self._stage is None and task is not None:
            raise DriverError(FaultCode.PROTOCOL, f"{self.name} is real and has no seed: leave it out")
        facts = await gate.measure_program(self._link, self._ur, prove_watchdog=not self._proven)
        checks = gate.judge_program(facts, self._ur)
        if failed := gate.failures(checks):
            raise DriverError(FaultCode.AUTHORITY, "; ".join(check.text for check in failed))
        self._note(checks)
        self._proven = self._proven or facts.watchdog_s is not None
        if self._stage is not None:
            await self._lay_out(self._stage, task)

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
        for helper in (self._camera, self._stage):
            if helper is not None:
                await helper.close()

    async def _lay_out(self, stage: Stage, task: Task | None) -> None:
        """Last of all that precedes a run, so that nothing but the run comes between it and the seed's world."""
        self._episode = 0  # the old world's samples end
        laid_out = await stage.lay_out(task)
        camera = self._camera

        def is_shown(package: Package) -> bool:
            seen = camera is None or camera.episode == laid_out.episode
            return 0.0 < package.time_s - laid_out.time_s < 2.0 * FRESH_S and seen

        if not await self._link.until(is_shown, FRESH_S):
            text = f"{self.name}: no samples, or no camera frames, of the world that was laid out; is it another arm's?"
            raise DriverError(FaultCode.STALE, text)
        self._link.resynchronise()  # its clock stood while it laid out
        self._episode = laid_out.episode

    # --- what arrives

    def _take(self, package: Package, arrival_s: float) -> None:
        sink, camera = self._sink, self._camera
        if sink is None:
            return
        if package.program == Program.ENGAGED and self._link.watch.running:
            self._judge_setting(package, sink)
        if self._episode and camera is not None and camera.episode != self._episode:
            sink.on_link_fault(FaultCode.SOURCE, f"{self.name}: somebody else laid out the world")
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
        """What the law was engaged with must stay as it is; others can set it while our program runs."""
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

    def _note(self, checks: tuple[gate.Check, ...]) -> None:
        """Keep what was found anew, beside what was not looked at this time."""
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
        """End the program; where the arm is then not measured to stand, cut its power.

        A program that has not taken a stop is not kept alive either: with no word from this side the watchdog ends it,
        although the dashboard may be gone.
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
        """Do one errand; return whether it was done. Whatever goes wrong with it, the next one must have its turn."""
        try:
            async with asyncio.timeout(ERRAND_S):
                await errand(self._ur)
        except Exception as error:
            _log.error("escalate", error=f"{type(error).__name__}: {error}")
            return False
        return True

    async def _comes_to_rest(self) -> bool:
        """Whether the arm is measured to stand, for a while, with no program that could go on."""
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
    """Written so that a speed that is not a number is none of rest."""
    return package.runtime_state == RuntimeState.STOPPED and all(abs(speed) < STANDSTILL_RAD_S for speed in package.qd)
