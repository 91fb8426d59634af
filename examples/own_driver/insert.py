"""A driver of one's own under the real cell: an insertion, a block without a hole, and a stop at a force ceiling.

    python examples/own_driver/insert.py

The cell, its process protection and the policy are those that ship; only the arm is a toy (world.py). To name a driver
in a cell's configuration, add it to `cell.driver` in `service/config/sections.py` and make it in
`service/commands/drivers.py`.
"""

import asyncio
import sys
import tempfile
from pathlib import Path

import numpy as np
from driver import PointMassDriver
from world import HOLE_RADIUS_M, PointMassArm

from service.messages import EventKind, Run
from service.safety.dsl import Phase
from service.testing import NOMINAL_HOLE_M, START_POSITION_M, cell_config, lockstep_cell

POLICY = Path(__file__).parents[2] / "models" / "vftm-dsl.onnx"


async def play(state_dir: Path, radius_m: float, force_ceiling_n: float) -> Run:
    """Run one insertion with our driver in place of the simulated one, and print what the cell reported."""

    def make_arm(seed: int) -> PointMassArm:
        aside = np.random.default_rng(seed).uniform(-0.01, 0.01, 2)
        hole = np.array(NOMINAL_HOLE_M) + np.array([*aside, 0.0])
        return PointMassArm(np.array(START_POSITION_M), hole, radius_m)

    config = cell_config(state_dir, POLICY, force_ceiling_n=force_ceiling_n, impact_n=40.0, max_steps=60)
    async with lockstep_cell(config, wrap=lambda _simulated: PointMassDriver(make_arm)) as bench:
        run = await bench.insert(seed=1)
        print("  ", " → ".join(event.state for event in bench.events if event.kind is EventKind.STATE))
        for record in bench.records:
            if record.dsl.phase == Phase.LOCKED:
                height_mm = (record.sample.tcp_position[2] - NOMINAL_HOLE_M[2]) * 1e3
                print(f"   contact at step {record.step}, {height_mm:+.2f} mm from the surface: the depth is locked")
                break
    print(f"   {run.code or run.state}: {run.text or 'the peg is in'}; peak force {run.peak_force_n:.1f} N\n")
    return run


async def main() -> int:
    """Play the three cases; return 0 if each ended as it should."""
    ends: list[str] = []
    cases = {"a hole": (HOLE_RADIUS_M, 30.0), "no hole": (0.0, 30.0), "no hole, a ceiling of 4 N": (0.0, 4.0)}
    for name, (radius_m, ceiling_n) in cases.items():
        print(f"{name}:")
        with tempfile.TemporaryDirectory() as folder:
            run = await play(Path(folder), radius_m, ceiling_n)
        ends.append(run.code or run.state)
    return 0 if ends == ["SUCCEEDED", "SEARCH_LIMIT", "FORCE_CEILING"] else 1


if __name__ == "__main__":
    sys.exit(asyncio.run(main()))
