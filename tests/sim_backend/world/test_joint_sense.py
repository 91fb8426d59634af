import numpy as np
import pytest

from sim_backend.world import scene
from sim_backend.world.joint_sense import JointSense
from sim_backend.world.world import World
from wire.task import Task

ONLY = np.array([0])
CENTRE, TCP = (0.0, 0.0, scene.PAYLOAD_COM_M), (0.0, 0.0, scene.TCP_OFFSET_M)
ERROR_N = 6.0
"""Error of the joints' force at rest: their friction."""


def feel(world: World, ticks: int = 200, payload_kg: float = scene.PAYLOAD_KG, seed: int = 0) -> np.ndarray:
    """Readings (ticks, 3) of an arm that holds its pose."""
    sense = JointSense()
    sense.begin(seed)
    readings = []
    for _ in range(ticks):
        world.tick()
        sense.read(world, payload_kg, CENTRE, TCP)
        readings.append(sense.force.copy())
    return np.array(readings)


@pytest.mark.parametrize("seed", range(8))
def test_joints_of_a_free_arm_feel_no_more_than_their_friction(seed: int) -> None:
    assert np.linalg.norm(feel(World(1), seed=seed).mean(0)) < ERROR_N


@pytest.mark.parametrize("down_m", [0.5e-3, 1e-3, 2e-3])
def test_joints_feel_what_the_surroundings_do_to_the_peg(down_m: float) -> None:
    world = World(1)
    x, y, z = world.hole_position[0]
    world.place(ONLY, np.array([[x + 0.045, y, z - down_m]]), world.hole_yaw[:1])
    feel(world, 300)
    true = world.contact_force[0]
    assert true[2] > 5.0
    assert feel(world)[100:].mean(0) == pytest.approx(true, abs=ERROR_N)


def test_a_payload_that_is_configured_wrongly_is_felt() -> None:
    felt = feel(World(1), payload_kg=scene.PAYLOAD_KG - 0.97).mean(0) - feel(World(1)).mean(0)
    assert felt == pytest.approx([0.0, 0.0, -0.97 * 9.81], abs=0.1)


def test_a_seed_repeats_the_readings_and_the_world_does_not_notice_them() -> None:
    worlds = [World(1), World(1)]
    for world in worlds:
        world.reset(ONLY, [Task(7)])
    first, second = feel(worlds[0], seed=7), feel(worlds[1], seed=7)
    assert (first == second).all()
    unread = World(1)
    unread.reset(ONLY, [Task(7)])
    for _ in range(200):
        unread.tick()
    assert (unread.sensor.wrench == worlds[0].sensor.wrench).all()
    assert (unread.joints == worlds[0].joints).all()


def test_the_true_contact_force_is_that_of_the_sensor_less_weight_noise_and_bias() -> None:
    world = World(1)
    x, y, z = world.hole_position[0]
    world.place(ONLY, np.array([[x + 0.045, y, z - 1e-3]]), world.hole_yaw[:1])
    loads = []
    for _ in range(500):
        world.tick()
        loads.append(-world._load[0, :3])
    weight = scene.PAYLOAD_KG * 9.81
    at_flange = world.rotation[0] @ np.mean(loads[-50:], axis=0)
    assert at_flange + np.array([0.0, 0.0, weight]) == pytest.approx(world.contact_force[0], abs=0.5)
