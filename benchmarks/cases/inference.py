"""The bare ONNX Runtime call of the shipped policy: hot, and after the rest that a policy's rate leaves it."""

import json
import subprocess
import sys

from benchmarks.harness.processes import ROOT
from benchmarks.harness.result import QUANTILES, Figure, Result, UnavailableError, median, quantile_figures, quantiles
from benchmarks.stands.bare_inference import REST_S
from benchmarks.stands.shipped_cell import shipped_cell

PATIENCE_S = 120.0


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the 20 000 hot calls and the 600 after a rest."""
    hot, rested = max(200, int(20_000 * scale)), max(20, int(600 * scale))
    with shipped_cell() as shipped:
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.stands.bare_inference", str(shipped.policy), str(hot), str(rested)],
            cwd=ROOT,
            capture_output=True,
            text=True,
            timeout=PATIENCE_S + rested * REST_S,
        )
        name = shipped.policy.name
    if done.returncode != 0:
        raise UnavailableError(f"the model did not run: {done.stderr[-500:]}")
    taken: dict[str, list[float]] = json.loads(done.stdout)
    times = median(taken["rested"]) / median(taken["hot"])
    return Result(
        question="What does the bare call of the shipped model cost, at its true rate too?",
        columns=("call", "count", *(f"{name} µs" for name in QUANTILES)),
        rows=(
            ("hot, one after the other", str(hot), *quantiles(taken["hot"])),
            (f"after {REST_S * 1e3:.0f} ms of rest", str(rested), *quantiles(taken["rested"])),
        ),
        finding=f"After a rest the call takes {times:.1f} times as long (median).",
        figures=(
            *quantile_figures("bare call, hot", taken["hot"], {"p50": 60.0}),
            *quantile_figures("bare call after a rest", taken["rested"], {"p50": 80.0}),
            Figure("call after a rest to a hot one", times, "times", 1.5),
        ),
        method=f"{name}, one thread, zeros, no checks; a process of its own with the scheduling of a policy's process.",
    )
