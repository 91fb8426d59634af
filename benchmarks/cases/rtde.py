"""RTDE read by the driver of a UR arm, beside a plain `struct` loop and beside `ur_rtde`, taking turns."""

import json
import subprocess
import sys
from dataclasses import dataclass, field

from benchmarks.harness.processes import ROOT, running
from benchmarks.harness.result import Figure, Result, UnavailableError, median
from benchmarks.stands.rtde_readers import VARIABLES, WARM_UP_S
from wire.rtde.messages import PORT

HOST = "127.0.0.30"  # an address of its own: ur_rtde supports only the standard port
RATE_HZ = 500
SPAN_S = 2.0
READERS = {
    "struct_loop": "plain struct loop",
    "on_asyncio": "this client, asyncio",
    "on_uvloop": "this client, uvloop",
    "ur_rtde": "ur_rtde",
}


@dataclass(slots=True)
class _Rounds:
    """Rounds of one reader: packages per CPU second in a flood, and CPU seconds per second at `RATE_HZ`."""

    flood: list[float] = field(default_factory=list[float])
    share: list[float] = field(default_factory=list[float])


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the 3 rounds of 2 s per row and rate."""
    count = max(1, int(3 * scale))
    rounds = {reader: _Rounds() for reader in READERS}
    for rate_hz in (0, RATE_HZ):
        with running("benchmarks.stands.rtde_source", HOST, str(PORT), str(rate_hz)):
            for reader in [*READERS] * count:
                packages, cpu_s = _read(reader)
                if rate_hz:
                    rounds[reader].share.append(cpu_s / SPAN_S)
                else:
                    rounds[reader].flood.append(packages / cpu_s)
    plain = rounds["struct_loop"]
    rows = tuple(
        (
            READERS[reader],
            f"{median(taken.flood) / 1e3:.0f}",
            f"{median(taken.flood) / median(plain.flood):.2f}",
            f"{median(taken.share):.1%}",
            f"{median(taken.share) / median(plain.share):.2f}",
        )
        for reader, taken in rounds.items()
    )
    ours, theirs = rounds["on_uvloop"], rounds["ur_rtde"]
    return Result(
        question="What does it cost to read every package of RTDE?",
        columns=("reader", "k packages per CPU s", "to struct", f"CPU at {RATE_HZ} Hz", "to struct"),
        rows=rows,
        finding=f"At {RATE_HZ} Hz this client on uvloop takes {median(ours.share) / median(theirs.share):.2f} of "
        f"ur_rtde's CPU time; in a flood it decodes {median(ours.flood) / median(plain.flood):.2f} of a plain "
        "loop's packages.",
        figures=(
            Figure("CPU of the client to ur_rtde", median(ours.share) / median(theirs.share), "times", 0.5),
            Figure("CPU per package to a plain struct loop", median(plain.flood) / median(ours.flood), "times", 4.0),
        ),
        method=f"{len(VARIABLES)} variables, {count} rounds of {SPAN_S:g} s by turns, medians; each reader in a "
        "process of its own, CPU time of all its threads. First a flood, as fast as the reader takes it, then "
        f"{RATE_HZ} Hz. ur_rtde skips a package if the next one has already arrived, in a flood nearly "
        "every one, so its first figure counts bytes read from the socket, not decoded packages. At "
        f"{RATE_HZ} Hz most of the time is the host's, for waking a process; a flood measures the decoding.",
    )


def _read(reader: str) -> tuple[int, float]:
    """Run one reader; return its packages and the CPU seconds spent on them."""
    arguments = [reader, HOST, str(PORT), str(SPAN_S)]
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.stands.rtde_readers", *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=WARM_UP_S + SPAN_S + 30,
    )
    if done.returncode != 0:
        raise UnavailableError(f"{READERS[reader]} did not read: {(done.stdout + done.stderr)[-500:]}")
    result = json.loads(done.stdout)
    return int(result["packages"]), float(result["cpu_s"])
