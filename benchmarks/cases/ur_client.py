"""CPU time of this driver for a UR arm's 500 packages a second, beside its client alone and beside ur_rtde."""

import importlib.util
import json
import subprocess
import sys
from dataclasses import dataclass, field

from benchmarks.harness.processes import ROOT, running
from benchmarks.harness.result import Figure, Result, UnavailableError, median
from benchmarks.stands.shipped_cell import ShippedCell
from benchmarks.stands.ur_cell import HOST, controller_options, shipped_ur_cell
from service.drivers.ur.samples import OUTPUTS
from service.program import MODULE

READERS = {
    "client_asyncio": "this client, asyncio: packages decoded",
    "client_uvloop": "this client, uvloop: packages decoded",
    "driver": "this driver, uvloop: samples, signs of life",
    "ur_rtde": "ur_rtde: its thread, asked for nothing",
    "ur_rtde_asked": "ur_rtde: asked for all values every 2 ms",
}
PATIENCE_S = 60.0


@dataclass(slots=True)
class _Rounds:
    """Rounds of one reader: CPU seconds per second, and packages seen per package sent."""

    share: list[float] = field(default_factory=list[float])
    seen: list[float] = field(default_factory=list[float])


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the 5 rounds of 5 s per reader, at least one of 2 s."""
    if importlib.util.find_spec("rtde_receive") is None:
        raise UnavailableError("ur_rtde is not installed; it comes with the development dependencies")
    count, span_s = max(1, int(5 * scale)), max(2.0, 5.0 * min(scale, 1.0))
    rounds = {reader: _Rounds() for reader in READERS}
    with shipped_ur_cell() as shipped, running(MODULE, "sim", *controller_options(shipped)):
        for reader in [*READERS] * count:
            share, seen = _read(shipped, reader, span_s)
            rounds[reader].share.append(share)
            rounds[reader].seen.append(seen)
    asked = median(rounds["ur_rtde_asked"].share)
    ours, driver = median(rounds["client_uvloop"].share), median(rounds["driver"].share)
    return Result(
        question="What do 500 packages a second of a UR controller cost their reader?",
        columns=("reader", "CPU", "to ur_rtde asked", "packages seen"),
        rows=tuple(
            (
                READERS[reader],
                f"{median(taken.share):.1%}",
                f"{median(taken.share) / asked:.2f}",
                "none" if reader == "ur_rtde" else f"{median(taken.seen):.1%}",
            )
            for reader, taken in rounds.items()
        ),
        finding=f"This client on uvloop takes {ours / asked:.2f} of the CPU time of ur_rtde asked for the same values; "
        f"the whole driver takes {driver / asked:.2f}.",
        figures=(Figure("CPU of the driver to ur_rtde asked", driver / asked, "times", 0.5),),
        method=f"One emulated controller in real time, the driver's {len(OUTPUTS)} variables, {count} rounds of "
        f"{span_s:g} s by turns, medians; each reader in a process of its own, CPU time of all its threads. "
        "This project's readers are called for every package. ur_rtde keeps the newest and is polled, here at "
        "500 Hz by the clock of the host for 13 of the variables.",
    )


def _read(shipped: ShippedCell, reader: str, span_s: float) -> tuple[float, float]:
    """Run one reader; return its CPU seconds per second, and the share of the packages that it saw."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.stands.ur_readers", reader, HOST, str(span_s)],
        cwd=ROOT,
        env=shipped.environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S + span_s,
    )
    if done.returncode != 0:
        raise UnavailableError(f"{READERS[reader]}, did not read: {(done.stdout + done.stderr)[-500:]}")
    result = json.loads(done.stdout)
    return float(result["cpu_s"]) / span_s, result["seen"] / max(1, result["sent"])
