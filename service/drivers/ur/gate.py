"""Start-up gate: the conditions on a controller before its arm is driven, each measured, judged and named.

`judge` is pure; `measure` collects the facts over an open link. A check that could not be made has not passed.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import IntEnum, StrEnum
from math import hypot

import numpy as np

from service.config import PreflightSection, UrSection
from service.drivers.base import DriverError
from service.drivers.ur.dashboard import DashboardError
from service.drivers.ur.link import UrLink
from service.drivers.ur.recovery import dashboard
from service.drivers.ur.samples import Package, SampleReader
from service.faults import FaultCode
from service.program import PROGRAM
from wire.arrays import FloatArray
from wire.rtde.modes import RobotMode, SafetyMode

MIN_VERSION = (5, 10, 0)
"""Oldest PolyScope 5 with `set_target_payload` and `ft_raw_wrench`."""
END_VERSION = (6, 0, 0)
MIN_SPEED_FRACTION = 0.999
PAYLOAD_TOLERANCE_KG = 0.005
POSITION_TOLERANCE_M = 1e-4
ROTATION_TOLERANCE_RAD = 1e-3
ROUND_TRIP_S = 0.1
"""Longest time through the registers and back, robot's time, s; a quiet network needs a tenth of it."""
WATCHDOG_MARGIN_S = 0.1
"""Allowance beyond the watchdog's period for the controller's reaction and the program's end, s."""
CONFIGURED_S = 1.0
"""Time within which the outputs must show the payload and TCP set by the program, s."""

UNSAFE = frozenset({"PolyScope", "robot", "registers", "payload", "TCP", "watchdog"})
"""Checks without which a cell is not connected at all. The other failures prevent a run; an operator corrects them
while watching the arm's samples.
"""


class Verdict(StrEnum):
    PASSED = "passed"
    FAILED = "FAILED"
    SKIPPED = "skipped"


@dataclass(frozen=True, slots=True)
class Check:
    """One line of the gate.

    Attributes:
        name: name of the check.
        measured: found value and wanted value.
        verdict: result.
        remedy: remedy after a failure; empty otherwise.
    """

    name: str
    measured: str
    verdict: Verdict
    remedy: str = ""

    @property
    def text(self) -> str:
        """Return the check as an error text."""
        return f"{self.name}: {self.measured}; {self.remedy}"


@dataclass(frozen=True, slots=True)
class Facts:
    """Measured facts; None if not measured.

    Attributes:
        version: version of PolyScope.
        model: model of the robot, as the dashboard names it.
        serial: serial number of the robot.
        remote_control: the controller takes programs from the network.
        package: package with the arm's present state.
        configured: package taken while the control program runs, with the payload and TCP that it has set.
        wrenches: (n, 6) N and N·m at the TCP of a standing arm: the sensor's own reading, never zeroed, less the weight
            of the payload of `[ur]`; taken before the control program is sent, which zeroes the sensor.
        round_trip_s: round trip of an empty order, s; infinite if it was lost.
        watchdog_s: time from the last package to the program's end, s; infinite if it never ended.
    """

    version: tuple[int, int, int] | None = None
    model: str | None = None
    serial: str | None = None
    remote_control: bool | None = None
    package: Package | None = None
    configured: Package | None = None
    wrenches: FloatArray | None = None
    round_trip_s: float | None = None
    watchdog_s: float | None = None


def judge(facts: Facts, ur: UrSection, preflight: PreflightSection) -> tuple[Check, ...]:
    """Judge the facts against the configuration, in the order in which an operator would correct them."""
    return (
        *judge_arm(facts, ur),
        *judge_load(facts, ur, preflight),
        *_judge_noise(facts, preflight),
        *_judge_program(facts, ur),
    )


def judge_arm(facts: Facts, ur: UrSection) -> tuple[Check, ...]:
    """Make the checks that precede the control program; they neither move nor change anything."""
    return tuple(_judge_arm(facts, ur))


def judge_load(facts: Facts, ur: UrSection, preflight: PreflightSection) -> tuple[Check, ...]:
    """Judge what loads the tool before the control program is sent: its start would zero the load away."""
    return tuple(_judge_load(facts, ur, preflight))


def judge_program(facts: Facts, ur: UrSection) -> tuple[Check, ...]:
    """Make the checks of arm and control program that precede every run."""
    return (*judge_arm(facts, ur), *_judge_program(facts, ur))


def tool_failures(package: Package, ur: UrSection) -> tuple[Check, ...]:
    """Return the failed checks of the controller's payload and TCP against the configuration."""
    return failures(tuple(_judge_tool(package, ur)))


def failures(checks: tuple[Check, ...]) -> tuple[Check, ...]:
    """Return the failed checks."""
    return tuple(check for check in checks if check.verdict is Verdict.FAILED)


async def measure_arm(link: UrLink, ur: UrSection) -> Facts:
    """Query the dashboard, and take the newest package.

    Raises:
        DriverError: LINK, the dashboard does not answer or no data arrive.
    """
    facts = await ask_dashboard(link.version, ur)
    return replace(facts, package=link.newest) if link.version < END_VERSION else facts


async def ask_dashboard(version: tuple[int, int, int], ur: UrSection) -> Facts:
    """Ask the dashboard which robot it is and who controls it; PolyScope X has no dashboard server and is not asked.

    Args:
        version: version of PolyScope.
        ur: section of the configuration.

    Raises:
        DriverError: LINK, the dashboard does not answer.
    """
    if version >= END_VERSION:
        return Facts(version=version)
    try:
        async with dashboard(ur) as client:
            model, serial = await client.robot_model(), await client.serial_number()
            remote = await client.is_in_remote_control()
    except DashboardError as error:
        raise DriverError(FaultCode.LINK, str(error)) from error
    return Facts(version=version, model=model, serial=serial, remote_control=remote)


async def measure(
    link: UrLink, ur: UrSection, preflight: PreflightSection, *, prove_watchdog: bool, load: bool = True
) -> Facts:
    """Collect the facts. Those beyond the arm's own need the control program, which is sent if it does not run.

    A program is not sent to an arm whose tool carries a load: its start zeroes the sensor.

    Args:
        link: open link.
        ur: section of the configuration.
        preflight: section with the number of samples to judge.
        prove_watchdog: let the watchdog end the program once, and start it again.
        load: measure the load of the tool first.

    Raises:
        DriverError: a fact cannot be measured. An arm that fails its own checks is no error; the remaining facts stay
            None.
    """
    facts = await measure_arm(link, ur)
    if failures(judge_arm(facts, ur)):
        return facts
    if load:
        facts = replace(facts, wrenches=await _window(link, SampleReader(ur), preflight.window_samples))
        if failures(judge_load(facts, ur, preflight)):
            return facts
    await link.run_program()
    round_trip_s = await link.exchange(1.0)
    await link.until(lambda package: not tool_failures(package, ur), CONFIGURED_S)
    configured = link.newest
    watchdog_s: float | None = None
    if prove_watchdog:
        took_s = await link.trip_watchdog(10.0 / ur.watchdog_hz + 1.0)
        watchdog_s = float("inf") if took_s is None else took_s
        await link.run_program()
    return replace(
        facts,
        configured=configured,
        round_trip_s=float("inf") if round_trip_s is None else round_trip_s,
        watchdog_s=watchdog_s,
    )


async def _window(link: UrLink, reader: SampleReader, samples: int) -> FloatArray:
    taken: list[FloatArray] = []
    seen = -1

    def take(package: Package) -> bool:
        nonlocal seen
        if package.tick != seen:
            seen = package.tick
            taken.append(reader.unzeroed(package))
        return len(taken) >= samples

    await link.until(take, samples / 50.0)
    return np.array(taken)


def _judge_arm(facts: Facts, ur: UrSection) -> Iterator[Check]:
    version = facts.version
    is_x = version is not None and version >= END_VERSION
    yield _check(
        "PolyScope",
        None if version is None else f"{'X, ' if is_x else ''}{'.'.join(map(str, version))}",
        version is not None and MIN_VERSION <= version < END_VERSION,
        f"from {'.'.join(map(str, MIN_VERSION))}, below 6",
        "use a controller with PolyScope 5: this driver needs its dashboard server and script, which PolyScope X does "
        "not have"
        if is_x
        else "update the controller's software: this driver is written for PolyScope 5",
    )
    yield _check(
        "robot",
        None if facts.serial is None else f"{facts.model}, serial number {facts.serial}",
        ur.model in (None, facts.model) and ur.serial in (None, facts.serial),
        f"{ur.model or 'any model'}, serial number {ur.serial or 'any'}",
        "another robot answers at this address: correct ur.host, or ur.model and ur.serial",
    )
    yield _check(
        "remote control",
        None if facts.remote_control is None else ("on" if facts.remote_control else "off"),
        facts.remote_control is True,
        "on",
        "enable it under Settings/System/Remote Control, then switch to it at the top right of the pendant",
    )
    package = facts.package
    yield _check(
        "safety mode",
        None if package is None else _name(SafetyMode, package.safety_mode),
        package is not None and package.safety_mode == SafetyMode.NORMAL,
        "NORMAL",
        f"inspect the cell; after a protective stop `{PROGRAM} ur unlock`, else see the pendant",
    )
    yield _check(
        "robot mode",
        None if package is None else _name(RobotMode, package.robot_mode),
        package is not None and package.robot_mode == RobotMode.RUNNING,
        "RUNNING",
        f"`{PROGRAM} ur power-on`, or switch on at the pendant and release the brakes",
    )
    yield _check(
        "speed slider",
        None if package is None else f"{package.speed_fraction:.0%}",
        package is not None and package.speed_fraction >= MIN_SPEED_FRACTION,
        "100%",
        "move it to 100 % on the pendant: below it the arm does not follow the law at its own pace",
    )


def _judge_tool(package: Package | None, ur: UrSection) -> Iterator[Check]:
    remedy = (
        "the control program sets what [ur] says as it starts: see that nothing else sets it, and that the arm may "
        "carry it; stop the program on the pendant, and the next start sends it again"
    )
    if package is None:
        yield Check("payload", "not measured", Verdict.SKIPPED)
        yield Check("TCP", "not measured", Verdict.SKIPPED)
        return
    mass_good = abs(package.payload_kg - ur.payload_kg) <= PAYLOAD_TOLERANCE_KG
    centre_good = _distance(package.payload_com, ur.payload_com_m) <= POSITION_TOLERANCE_M
    yield _check(
        "payload",
        f"{package.payload_kg:.3f} kg at {_millimetres(package.payload_com)} mm",
        mass_good and centre_good,
        f"{ur.payload_kg:.3f} kg at {_millimetres(ur.payload_com_m)} mm",
        remedy,
    )
    place_good = _distance(package.tcp_offset[:3], ur.tcp_m[:3]) <= POSITION_TOLERANCE_M
    turn_good = _distance(package.tcp_offset[3:], ur.tcp_m[3:]) <= ROTATION_TOLERANCE_RAD
    yield _check(
        "TCP",
        f"{_millimetres(package.tcp_offset[:3])} mm, {_radians(package.tcp_offset[3:])} rad",
        place_good and turn_good,
        f"{_millimetres(ur.tcp_m[:3])} mm, {_radians(ur.tcp_m[3:])} rad",
        remedy,
    )


def _judge_program(facts: Facts, ur: UrSection) -> Iterator[Check]:
    trip_s = facts.round_trip_s
    yield _check(
        "registers",
        None if trip_s is None else f"back after {trip_s * 1e3:.0f} ms",
        trip_s is not None and trip_s <= ROUND_TRIP_S,
        f"within {ROUND_TRIP_S * 1e3:.0f} ms",
        "find out who else writes registers 24 to 47 (a field bus, another client), and what loads the network",
    )
    yield from _judge_tool(facts.configured, ur)
    watchdog_s, limit_s = facts.watchdog_s, 1.0 / ur.watchdog_hz + WATCHDOG_MARGIN_S
    yield _check(
        "watchdog",
        None if watchdog_s is None else f"ended the program after {watchdog_s * 1e3:.0f} ms",
        watchdog_s is not None and watchdog_s <= limit_s,
        f"within {limit_s * 1e3:.0f} ms",
        "do not run this cell: an arm would go on without its host. Report the controller's version",
    )


def _judge_load(facts: Facts, ur: UrSection, preflight: PreflightSection) -> Iterator[Check]:
    wrenches = facts.wrenches
    if wrenches is None or len(wrenches) < 2:
        yield Check("F/T load", "not measured", Verdict.SKIPPED)
        return
    mean = wrenches.mean(axis=0)
    force_n, torque_nm = hypot(*mean[:3].tolist()), hypot(*mean[3:].tolist())
    limit_n, limit_nm = preflight.unzeroed_force_n, preflight.unzeroed_torque_nm
    yield _check(
        "F/T load",
        f"{force_n:.1f} N, {torque_nm:.2f} N·m beside the payload",
        force_n < limit_n and torque_nm < limit_nm,
        f"below {limit_n:g} N, {limit_nm:g} N·m",
        f"free the tool; if it is free, weigh the payload again ({ur.payload_kg:g} kg is configured)",
    )


def _judge_noise(facts: Facts, preflight: PreflightSection) -> Iterator[Check]:
    wrenches = facts.wrenches
    if wrenches is None or len(wrenches) < 2:
        yield Check("F/T noise", "not measured", Verdict.SKIPPED)
        return
    spread = wrenches.std(axis=0)
    noise_n, noise_nm = float(spread[:3].max()), float(spread[3:].max())
    limit_n, limit_nm = preflight.noise_force_n, preflight.noise_torque_nm
    yield _check(
        "F/T noise",
        f"{noise_n:.2f} N, {noise_nm:.3f} N·m",
        0.0 < noise_n <= limit_n and noise_nm <= limit_nm,
        f"above 0, at most {limit_n:g} N, {limit_nm:g} N·m",
        "see that the arm stands, nothing shakes it, and the sensor is connected: one without noise is not measured",
    )


def _check(name: str, found: str | None, good: bool, wanted: str, remedy: str) -> Check:
    if found is None:
        return Check(name, "not measured", Verdict.SKIPPED)
    if good:
        return Check(name, f"{found} ({wanted})", Verdict.PASSED)
    return Check(name, f"{found}, wanted {wanted}", Verdict.FAILED, remedy)


def _name(modes: type[IntEnum], number: int) -> str:
    try:
        return modes(number).name
    except ValueError:
        return str(number)


def _distance(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    return hypot(*(x - y for x, y in zip(a, b, strict=True)))


def _millimetres(values: tuple[float, ...]) -> str:
    return "[" + ", ".join(f"{value * 1e3:.1f}" for value in values) + "]"


def _radians(values: tuple[float, ...]) -> str:
    return "[" + ", ".join(f"{value:.3f}" for value in values) + "]"
