from pathlib import Path

from service.messages import CellState, RunState
from service.testing import cell_config, lockstep_cell

SHIPPED = Path(__file__).parents[3] / "models" / "triangle-vftm.onnx"


async def test_a_peg_that_was_turned_against_its_hole_comes_out_again(tmp_path: Path) -> None:
    """On this seed the last command twists the peg by 0.9 N·m; pulled in that twist it jammed at the force ceiling."""
    config = cell_config(tmp_path, SHIPPED, clearance_m=3e-3, conditions="easy")
    async with lockstep_cell(config) as bench:
        run = await bench.insert(seed=0)
        assert run.state is RunState.SUCCEEDED, run.text
        assert bench.cell.state is CellState.READY
        truth = bench.world.truth()
        assert truth["depth"] < -0.010  # out of the hole, and standing above it
        assert max(point.force_peak_n for point in bench.telemetry) < 20.0
