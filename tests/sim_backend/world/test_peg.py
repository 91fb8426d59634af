"""A peg that was not made to size touches the walls of its hole where its shape says, by MuJoCo's own reckoning."""

import dataclasses

import mujoco
import numpy as np
import pytest

from sim_backend.world import kinematics, scene
from sim_backend.world.parts import PARTS, yaw_tolerance
from sim_backend.world.peg import PegShape, offset, shape_of, vertices
from sim_backend.world.world import World
from sim_backend.zenoh_cell.cell import SimulatedCell
from tests.sim_backend.world.plants import EVERY, ODD_PEG
from wire import pose
from wire.arrays import FloatArray
from wire.task import Task

C = 0.33e-3
NEAR = np.array([-0.2, -1.9, -1.7, -1.1, 1.57, 0.0])
EXACT = PegShape()
DEEP = 5e-3


def touch(part: str, shape: PegShape, at: FloatArray, yaw: float = 0.0) -> float:
    """Smallest distance between the peg, its tip `at` (3,) in the hole's frame, and the walls, m; 1 if none is near."""
    made = scene.build(part, C, shape)
    data = mujoco.MjData(made.model)
    rotation = pose.tool_down(yaw)
    flange = np.array(scene.NOMINAL_HOLE_M) + at - rotation @ [0.0, 0.0, scene.TCP_OFFSET_M]
    data.qpos[:6] = kinematics.inverse(flange, rotation, NEAR)
    mujoco.mj_forward(made.model, data)
    return min((float(contact.dist) for contact in data.contact[: data.ncon]), default=1.0)


def towards_wall(part: str, distance: float, depth: float = DEEP) -> FloatArray:
    """Place of the tip, moved towards the first wall."""
    return np.array([*(distance * PARTS[part].wall_normal[0]), -depth])


@pytest.mark.parametrize("part", ["tr", "rtr", "trm", "cir"])
def test_an_oversize_peg_touches_a_wall_that_much_earlier(part: str) -> None:
    shape = PegShape(oversize_m=0.05e-3)
    facets = 20e-6 if part == "cir" else 2e-6
    assert touch(part, EXACT, towards_wall(part, C - 0.03e-3)) == 1.0
    assert touch(part, shape, towards_wall(part, C - 0.08e-3)) == 1.0
    assert touch(part, shape, towards_wall(part, C - 0.03e-3)) == pytest.approx(-0.02e-3, abs=facets)


def test_a_rounded_peg_turns_further_before_its_edges_touch() -> None:
    beyond = float(yaw_tolerance(PARTS["tr"], C)) + np.deg2rad(0.1)
    centred = np.array([0.0, 0.0, -DEEP])
    assert touch("tr", EXACT, centred, beyond) < -1e-5
    assert touch("tr", PegShape(rounding_m=1e-3), centred, beyond) == 1.0


def test_a_rounded_edge_lies_its_radius_within_the_sharp_one() -> None:
    reach = [np.linalg.norm(vertices(PARTS["tr"], PegShape(rounding_m=r))[:, :2], axis=1).max() for r in (0.0, 1e-3)]
    assert reach[0] - reach[1] == pytest.approx(1e-3, rel=1e-6)  # 60°: the centre is 2 r from the corner


def test_a_chamfered_peg_enters_where_a_sharp_one_stands_on_the_rim() -> None:
    shape = PegShape(chamfer_m=0.3e-3)
    beside = [towards_wall("tr", C + 0.1e-3, depth) for depth in (0.1e-3, 0.4e-3)]
    assert touch("tr", EXACT, beside[0]) < -0.05e-3
    assert touch("tr", shape, beside[0]) == 1.0
    assert touch("tr", shape, beside[1]) == pytest.approx(-0.1e-3, abs=5e-6)


def test_a_chamfer_larger_than_the_rounding_ends_in_sharp_corners() -> None:
    found = vertices(PARTS["tr"], PegShape(chamfer_m=0.3e-3, rounding_m=0.2e-3))
    assert found[found[:, 2] == 0.0][:, :2] == pytest.approx(offset(PARTS["tr"].outline, -0.3e-3))


def test_a_tapered_peg_gets_stuck_as_it_goes_down() -> None:
    shape = PegShape(taper_deg=1.0)
    places = [towards_wall("tr", C - 0.03e-3, depth) for depth in (1e-3, 5e-3)]
    assert [touch("tr", EXACT, place) for place in places] == [1.0, 1.0]
    assert touch("tr", shape, places[0]) == 1.0
    assert touch("tr", shape, places[1]) == pytest.approx(0.03e-3 - 5e-3 * np.tan(np.deg2rad(1.0)), abs=3e-6)


@pytest.mark.parametrize("part", PARTS)
def test_a_peg_with_errors_has_the_outline_of_its_part(part: str) -> None:
    whole = PARTS[part]
    assert vertices(whole, PegShape())[: len(whole.outline), :2] == pytest.approx(whole.outline)
    assert offset(offset(whole.outline, 1e-3), -1e-3) == pytest.approx(whole.outline)
    odd = vertices(whole, dataclasses.replace(shape_of(ODD_PEG), taper_deg=0.0))
    reach = (odd[:, :2] @ whole.wall_normal.T).max(0)
    assert reach == pytest.approx(whole.wall_reach + 0.05e-3, abs=1e-9 if whole.face == "straight" else 20e-6)
    assert odd[:, 2].max() == 0.0
    assert odd[:, 2].min() == -whole.peg_height_m


def test_a_world_holds_pegs_of_one_shape() -> None:
    world = World(2, plant=ODD_PEG)
    both = dataclasses.replace(EVERY, **ODD_PEG.to_json())
    world.reset(np.arange(2), [Task(1, plant=ODD_PEG), Task(2, plant=both)])
    with pytest.raises(ValueError, match=r"this world holds .*chamfer_m=0\.0003.*, the task asks for .*start another"):
        world.reset(np.arange(1), [Task(1)])


def test_a_simulated_cell_takes_another_peg_for_a_task_that_asks_for_it() -> None:
    cell = SimulatedCell()
    for plant in (ODD_PEG, None):
        cell.reset(Task(1, plant=plant))
        assert cell.world.holds(Task(2, plant=plant))
        assert (cell.model().nmeshvert > 6) == (plant is not None)
