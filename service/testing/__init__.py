"""A whole simulated cell inside a test, in lockstep, for tests of recipes and policies.

    async def test_my_policy_inserts(simulated_cell):
        async with simulated_cell(policy=Path("mine.onnx"), clearance_m=1e-3) as bench:
            run = await bench.insert(seed=7)
            assert run.state is RunState.SUCCEEDED
            assert max(float(record.depth_m) for record in bench.records) > 3e-3

`simulated_cell` is a pytest fixture (entry point `pytest11`). Nothing at run time imports this package.
"""

from service.testing.bench import (
    NOMINAL_HOLE_M,
    RECIPE,
    START_POSITION_M,
    Bench,
    SimulatedCellFactory,
    cell_config,
    lockstep_cell,
    simulated_cell,
)

__all__ = [
    "NOMINAL_HOLE_M",
    "RECIPE",
    "START_POSITION_M",
    "Bench",
    "SimulatedCellFactory",
    "cell_config",
    "lockstep_cell",
    "simulated_cell",
]
