"""A policy of one's own: an ONNX file written by hand, with its contract, and the tests that it must pass.

    python examples/own_policy.py mine.onnx     # writes the file
    pytest examples/own_policy.py               # runs it in a whole simulated cell

The network is one matrix: it moves the peg towards the hole that the camera sees, and the safety lock brings it down.
It knows nothing of yaw: it inserts where the hole is not turned, and must do no harm where it is.
"""

import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from service.faults import FaultCode
from service.messages import RunState
from service.policy.contract import ActionEntry, ObservationEntry, PolicyContract
from service.safety.dsl import DslParameters, Phase
from service.testing import SimulatedCellFactory
from wire.law import ComplianceLaw

# Stored in the file. From it the cell builds the observation, and it refuses a policy that does not fit the recipe.
CONTRACT = PolicyContract(
    name="towards the hole",
    parts=("tr",),
    clearance_m=(1e-3, 3e-3),
    mode="VFTM",
    ticks_per_step=50,  # of 2 ms: ten actions a second
    max_steps=110,
    observation=(ObservationEntry.of("hole_offset_xy"),),  # metres, in the tool's frame
    action=(
        ActionEntry(name="dx", unit="m", frame="tool", limit=3e-3),
        ActionEntry(name="dy", unit="m", frame="tool", limit=3e-3),
        ActionEntry(name="dz", unit="m", frame="base", limit=1.5e-3),
        ActionEntry(name="dyaw", unit="rad", frame="base", limit=0.14),
    ),
    dsl=DslParameters(seek_step_m=2e-3, press_m=2e-3),
    compliance=ComplianceLaw(
        stiffness=(2500, 2500, 3000, 5, 5, 8),
        damping=(380, 380, 650, 1, 1, 0.5),
        inertia=(2.5, 2.5, 2.5, 0.06, 0.06, 0.03),
    ),
    wrench_window_ticks=25,
)


def write(path: Path) -> Path:
    """Write `action = tanh(observation @ W)`: (batch, 2) metres in, (batch, 4) in -1 … 1 out."""
    weights = np.zeros((CONTRACT.observation_size, len(CONTRACT.action)), np.float32)
    weights[0, 0] = weights[1, 1] = 300.0  # 3 mm aside: 0.9, before tanh
    nodes = [helper.make_node("MatMul", ["observation", "W"], ["a"]), helper.make_node("Tanh", ["a"], ["action"])]
    sizes = {"observation": weights.shape[0], "action": weights.shape[1]}
    ends = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size]) for name, size in sizes.items()]
    graph = helper.make_graph(nodes, "policy", ends[:1], ends[1:], [numpy_helper.from_array(weights, "W")])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, CONTRACT.to_metadata())
    onnx.save(model, path)
    return path


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    return write(tmp_path / "mine.onnx")


# The same seed draws the same world: seed 3 one whose hole is hardly turned, seed 0 one whose hole is.


async def test_it_inserts_where_the_hole_is_not_turned(simulated_cell: SimulatedCellFactory, policy: Path) -> None:
    async with simulated_cell(policy, conditions="easy") as bench:
        run = await bench.insert(seed=3)
        assert run.state is RunState.SUCCEEDED, run.text
        heights_m = [record.sample.tcp_position[2] for record in bench.records]
        assert heights_m[0] - heights_m[-1] > 20e-3, "from above the block down into the hole"
        assert run.peak_force_n < 10.0


async def test_it_does_not_force_a_peg_into_a_turned_hole(simulated_cell: SimulatedCellFactory, policy: Path) -> None:
    async with simulated_cell(policy, conditions="easy", max_steps=50) as bench:
        run = await bench.insert(seed=0)
        assert (run.state, run.code) == (RunState.FAILED, FaultCode.SEARCH_LIMIT), run.text
        touching = [record for record in bench.records if record.dsl.phase == Phase.LOCKED]
        assert touching, "the peg never reached the block"
        assert max(np.linalg.norm(record.sample.wrench[:3]) for record in touching) < 15.0
        for record in touching:
            assert record.bounded.position[2] >= record.dsl.z_lock - CONTRACT.dsl.press_m - 1e-9
            assert np.linalg.norm(record.observation) < 1e-3, "it stays where the camera sees the hole"


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("name the file to write: python examples/own_policy.py mine.onnx")
    print(f"wrote {write(Path(sys.argv[1]))}: {CONTRACT.name}")
