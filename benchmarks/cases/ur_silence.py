"""Behaviour of a pushing UR arm whose host falls silent: control processes killed, and hosts muted."""

import asyncio
import random
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.cases.ur_ceiling import GENTLE_M_S
from benchmarks.harness import operating
from benchmarks.harness.processes import running
from benchmarks.harness.result import Figure, Result, UnavailableError
from benchmarks.stands.pressed_arm import PressedArm
from benchmarks.stands.recorded_controller import CONTACT
from benchmarks.stands.shipped_cell import ShippedCell
from benchmarks.stands.ur_cell import controller_options, plan_first, shipped_ur_cell
from service.cell.plan import Plan
from service.client import CellClient
from service.config import CellConfig
from service.program import MODULE
from service.safety.stop import STANDSTILL_M_S
from wire.arrays import FloatArray
from wire.records import TICK_S
from wire.task import Task

CONTACT_TIMEOUT_S = 20.0
"""Time from a run's start, s; a peg without contact by then has found the hole."""
LATER_S = 0.1
"""Longest time from contact to the kill, s."""
WATCHED_S = 0.6
"""Time observed from the last package, s: watchdog, stop, and standstill for a while."""
STILL_S = 0.1
"""Time below the speed of standstill that counts as standstill, s."""
FORCES_N = (3.0, 25.0)
HEIGHTS_M = (0.0, 0.005)
LONGEST_PRESS_TICKS = 2000


class Silence(NamedTuple):
    """One silence of a host.

    Attributes:
        ended_s: time from the last package to the program's end.
        stood_s: time from the last package to the standstill of the TCP.
        at_n: true force on the peg at the last package.
        peak_n: largest true force from then on.
    """

    ended_s: float
    stood_s: float
    at_n: float
    peak_n: float


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the 10 kills and the 20 muted hosts per row."""
    with shipped_ur_cell() as shipped:
        plan = plan_first(shipped.config)
        killed = _kills(shipped, max(2, int(10 * scale)))
    count = max(2, int(20 * scale))
    speeds = GENTLE_M_S, shipped.config.limits.max_speed_m_s
    pushing, driving = (
        [_mute(shipped.config, plan, speed_m_s, Task(seed)) for seed in range(count)] for speed_m_s in speeds
    )
    ceiling_n = plan.limits.force_ceiling_n
    ways = {
        "control process killed in an insertion, pressing": killed,
        f"muted while it presses, targets at {speeds[0] * 1e3:.0f} mm/s": pushing,
        f"muted just above the block, targets at {speeds[1] * 1e3:.0f} mm/s": driving,
    }
    assert shipped.config.ur is not None  # noqa: S101  # the cell has one
    watchdog_s = 1.0 / shipped.config.ur.watchdog_hz
    slowest_s = max(silence.ended_s for silence in killed)
    worst_n = max(silence.peak_n for silences in ways.values() for silence in silences)
    return Result(
        question="What does a UR arm do when its host dies while it pushes?",
        columns=(
            *("way", "count", "program ends p50 ms", "ends max ms", "standstill p50 ms", "standstill max ms"),
            *("true N at last package", "peak true N max", "to the ceiling N"),
        ),
        rows=tuple((way, *_summed_up(silences, ceiling_n)) for way, silences in ways.items()),
        finding=f"A killed control process's program ends at most {slowest_s * 1e3:.0f} ms after the last package "
        f"(watchdog {watchdog_s * 1e3:.0f} ms); the largest true force is {worst_n - ceiling_n:+.1f} N relative to the "
        f"ceiling of {ceiling_n:g} N.",
        figures=(Figure("end of the program after silence", slowest_s * 1e3, "ms", watchdog_s * 1e3 + 10.0),),
        method="Killed: emulated controller and control process in real time; the latter gets SIGKILL within "
        f"{LATER_S * 1e3:.0f} ms after the peg has begun to press in an insertion. Muted: tick by tick in this "
        f"process, the peg over the block beside the hole, a host that stops writing registers at a true force of "
        f"{FORCES_N[0]:g}-{FORCES_N[1]:g} N, or {HEIGHTS_M[0] * 1e3:g}-{HEIGHTS_M[1] * 1e3:g} mm above the block. All "
        f"times from the last package; standstill: below {STANDSTILL_M_S * 1e3:g} mm/s for {STILL_S * 1e3:g} ms.",
    )


def _summed_up(silences: Sequence[Silence], ceiling_n: float) -> tuple[str, ...]:
    ended, stood, at, peak = np.array(silences).T
    return (
        str(len(silences)),
        *(f"{value * 1e3:.0f}" for value in (np.median(ended), ended.max(), np.median(stood), stood.max())),
        *(f"{np.median(at):.1f}", f"{peak.max():.1f}", f"{peak.max() - ceiling_n:+.1f}"),
    )


def _mute(config: CellConfig, plan: Plan, speed_m_s: float, task: Task) -> Silence:
    """Press, and fall silent: in contact if the target sinks gently, before contact if it does not."""
    arm = PressedArm(config, plan, plan.limits.force_ceiling_n, task)
    chance = random.Random(task.seed)  # noqa: S311  # not secret
    force_n, height_m = chance.uniform(*FORCES_N), chance.uniform(*HEIGHTS_M)
    for _ in range(LONGEST_PRESS_TICKS):
        arm.press(speed_m_s)
        if arm.true_n >= force_n if speed_m_s == GENTLE_M_S else arm.height_m <= height_m:
            break
    else:
        raise UnavailableError(f"the peg never came to the block: {task}")
    arm.silent = True
    at_n, rows = arm.true_n, list[tuple[bool, float, float]]()
    for _ in range(round(WATCHED_S / TICK_S)):
        arm.press(speed_m_s)
        rows.append((arm.runs, arm.speed_m_s, arm.true_n))
    running_then, speed, force = np.array(rows).T
    times_s = np.arange(1, len(rows) + 1, dtype=np.float64) * TICK_S
    return Silence(*_ends(times_s, running_then, speed), at_n, max(at_n, float(force.max())))


def _kills(shipped: ShippedCell, count: int) -> list[Silence]:
    output = shipped.config.cell.state_dir / "record.npy"
    killed_s: list[float] = []
    lines: list[str] = []
    controller = "benchmarks.stands.recorded_controller", str(output), *controller_options(shipped)
    with running(*controller, lines=lines) as recorded:
        for seed in range(count):
            with running(MODULE, "control", ready="serving", environment=shipped.environment) as service:
                heard = len(lines)
                asyncio.run(_start(shipped, seed))
                if not _is_pressing(lines, heard):
                    continue
                time.sleep(random.Random(seed).uniform(0.0, LATER_S))  # noqa: S311  # not secret
                killed_s.append(time.monotonic())
                service.kill()
                service.wait()
            time.sleep(WATCHED_S + LATER_S)
        recorded.terminate()
        recorded.wait(10)
        record = np.load(output)
    if not killed_s:
        raise UnavailableError(f"in none of {count} insertions the peg pressed on anything")
    return [_silence(record, moment_s) for moment_s in killed_s]


async def _start(shipped: ShippedCell, seed: int) -> None:
    async with CellClient(shipped.config.cell.id, [shipped.config.cell.endpoint]) as client:
        try:
            await operating.start(client, shipped.recipe, seed)
        except operating.LatchedError:  # the cell reports that its last run was interrupted
            await operating.reset(client)
            await operating.start(client, shipped.recipe, seed)


def _is_pressing(lines: list[str], heard: int) -> bool:
    """Wait until the controller reports contact again."""
    deadline_s = time.monotonic() + CONTACT_TIMEOUT_S
    while not any(CONTACT in line for line in lines[heard:]):
        if time.monotonic() > deadline_s:
            return False
        time.sleep(TICK_S)
    return True


def _silence(record: FloatArray, killed_s: float) -> Silence:
    """Cut the part after the last package of a killed control process from a record."""
    near = record[(record[:, 0] > killed_s - WATCHED_S) & (record[:, 0] < killed_s + WATCHED_S)]
    last = int(np.flatnonzero(near[:, 1])[-1])
    times_s, _, runs, speed, force = near[last:].T
    return Silence(*_ends(times_s - times_s[0], runs, speed), float(force[0]), float(force.max()))


def _ends(times_s: FloatArray, runs: FloatArray, speed: FloatArray) -> tuple[float, float]:
    """Return the times at which the program had ended and from which on the TCP stood for `STILL_S`.

    A peg left under load may slip into its hole long after the arm has come to rest; that is no motion of the arm. The
    second time is infinite if the TCP never stands: a jammed peg may keep vibrating, by micrometres, above that speed.

    Raises:
        UnavailableError: the program did not end.
    """
    ticks = round(STILL_S / TICK_S)
    stands = np.convolve(speed < STANDSTILL_M_S, np.ones(ticks), "valid") > ticks - 0.5
    if runs.all():
        raise UnavailableError("the program did not end after the last package")
    stood_s = float(times_s[int(np.argmax(stands))]) if stands.any() else float("inf")
    return float(times_s[int(np.argmin(runs))]), stood_s
