"""One arm as its controller sees it, held at rest by constant joint targets unless a test says otherwise."""

import numpy as np
import pytest

from sim_backend.ur_controller.geometry import compose, invert
from sim_backend.ur_controller.motion.inverse import inverse_at
from sim_backend.ur_controller.plant import Plant
from sim_backend.world import kinematics, scene
from sim_backend.world.world import START_POSITION_M, World
from wire.plant import PlantErrors
from wire.task import Task

STILL = np.zeros(6)
TOOL = (0.01, -0.02, 0.15, 0.3, -0.2, 0.5)
WEIGHT_N = scene.PAYLOAD_KG * kinematics.GRAVITY_M_S2


@pytest.fixture
def plant():
    plant = Plant(World(1))
    hold(plant, 200)
    plant.zero_ft()
    return plant


def hold(plant, ticks, q=None):
    """Mean wrench of the last half of some ticks during which the joints are to stay at `q`."""
    q = plant.q if q is None else q
    seen = []
    for _ in range(ticks):
        plant.drive(q, STILL)
        seen.append(plant.wrench)
    return np.mean(seen[ticks // 2 :], axis=0)


def test_the_arm_follows_joint_targets_that_move_and_those_that_stand(plant):
    q = plant.q
    speed = np.array([0.1, 0.2, -0.1, 0.3, -0.2, 0.4])
    for _ in range(250):
        q = q + 0.002 * speed
        plant.drive(q, speed)
    assert plant.q == pytest.approx(q, abs=1e-3)  # a tick ahead
    assert plant.qd == pytest.approx(speed, abs=0.01)
    hold(plant, 100, q)
    assert plant.q == pytest.approx(q, abs=1e-4)
    assert plant.qd == pytest.approx(STILL, abs=1e-3)


def test_the_tcp_is_the_scenes_until_another_is_configured(plant):
    assert plant.tcp_pose()[:3] == pytest.approx(START_POSITION_M, abs=1e-4)
    flange = plant.flange_pose_of(plant.q.tolist())
    plant.set_tcp(TOOL)
    assert plant.tcp_pose() == pytest.approx(compose(flange, TOOL))
    assert plant.tcp_pose_of(plant.q.tolist()) == plant.tcp_pose()


def test_the_twist_is_the_change_of_the_pose(plant):
    plant.set_tcp(TOOL)
    q, speed = plant.q, np.array([0.3, -0.2, 0.4, 0.5, -0.3, 0.6])
    for _ in range(200):
        q = q + 0.002 * speed
        plant.drive(q, speed)
    before, twist = plant.tcp_pose(), plant.tcp_speed()
    plant.drive(q + 0.002 * speed, speed)
    step = compose(plant.tcp_pose(), invert(before))
    assert (np.array(plant.tcp_pose()) - before)[:3] / 0.002 == pytest.approx(twist[:3], abs=2e-3)
    assert np.array(step[3:]) / 0.002 == pytest.approx(twist[3:], abs=5e-3)


def test_the_inverse_is_the_inverse_at_the_configured_tcp(plant):
    plant.set_tcp(TOOL)
    goal = compose(plant.tcp_pose(), [0.01, 0.02, -0.01, 0.1, 0.0, -0.2])
    q = inverse_at(goal, plant.tcp_offset, plant.q.tolist())
    reached = compose(plant.tcp_pose_of(q), invert(goal))
    assert reached == pytest.approx(np.zeros(6), abs=1e-9)
    with pytest.raises(kinematics.KinematicsError):
        inverse_at([1.5, 0, 0, 0, 0, 0], plant.tcp_offset, plant.q.tolist())


def test_at_rest_a_zeroed_sensor_reads_nothing_and_raw_reads_the_weight(plant):
    wrench = hold(plant, 400)
    assert wrench[:3] == pytest.approx(np.zeros(3), abs=0.25)
    assert wrench[3:] == pytest.approx(np.zeros(3), abs=0.05)
    assert plant.ft_raw[2] == pytest.approx(WEIGHT_N, abs=8.0)  # and its bias


@pytest.mark.parametrize(("kg", "cog"), [(0.0, (0.0, 0.0, 0.0)), (2.0, (0.0, 0.0, scene.PAYLOAD_COM_M))])
def test_a_payload_configured_wrongly_shows_as_a_force(plant, kg, cog):
    right = hold(plant, 400)
    plant.set_payload(kg, cog)
    wrong = hold(plant, 400)
    assert (wrong - right)[:3] == pytest.approx([0, 0, (kg - scene.PAYLOAD_KG) * 9.81], abs=0.3)


def test_a_centre_of_gravity_beside_the_axis_shows_as_a_moment(plant):
    right = hold(plant, 400)
    plant.set_payload(scene.PAYLOAD_KG, (0.03, 0.0, scene.PAYLOAD_COM_M))
    wrong = hold(plant, 400)
    # the tool points down and its x axis along the base's: the weight assumed at +x turns about -y, in base axes
    assert (wrong - right)[3:] == pytest.approx([0, -0.03 * WEIGHT_N, 0], abs=0.05)


def test_a_zero_taken_right_after_another_payload_is_that_payloads(plant):
    plant.set_payload(0.0, (0.0, 0.0, 0.0))
    plant.zero_ft()
    wrench = hold(plant, 400)
    assert wrench[:3] == pytest.approx(np.zeros(3), abs=0.25)
    assert wrench[3:] == pytest.approx(np.zeros(3), abs=0.05)


def test_the_arm_stands_still_whatever_payload_it_was_told_but_for_its_sag(plant):
    before = np.array(plant.tcp_pose()[:3])
    held = plant.q
    plant.set_payload(0.0, (0.0, 0.0, 0.0))
    hold(plant, 300, held)
    sag = before - plant.tcp_pose()[:3]
    assert 1e-4 < sag[2] < 3e-3


def press(plant):
    """Push the peg down onto the table beside the block; returns the joints held and the mean wrench."""
    plant.place((0.30, -0.35, 0.006))
    hold(plant, 100)
    plant.zero_ft()
    goal = plant.tcp_pose()
    q = plant.q
    for step in range(200):
        lower = [*goal[:2], goal[2] - 0.0065 * step / 200, *goal[3:]]
        target = np.array(inverse_at(lower, plant.tcp_offset, q.tolist()))
        plant.drive(target, (target - q) / 0.002)
        q = target
    return q, hold(plant, 200, q)


def test_contact_pushes_back_and_its_moment_is_carried_to_tcp_and_flange(plant):
    q, wrench = press(plant)
    assert wrench[2] > 3.0
    assert plant.true_force != pytest.approx(WEIGHT_N, abs=1.0)
    plant.set_tcp((0.05, 0.0, scene.TCP_OFFSET_M, 0.0, 0.0, 0.0))
    beside = hold(plant, 200, q)
    # seen from 5 cm along +x, an upward force at the old TCP turns about +y
    assert beside[4] - wrench[4] == pytest.approx(0.05 * wrench[2], rel=0.3)
    force, moment = plant.wrench[:3], plant.wrench[3:]
    lever = np.array(plant.tcp_pose()[:3]) - plant.flange()[0]
    assert plant.flange_wrench() == pytest.approx([*force, *(moment + np.cross(lever, force))])


def test_another_episode_puts_the_arm_at_its_start_and_says_so(plant):
    heard = []
    plant.on_placed.append(lambda: heard.append(plant.q.copy()))
    plant.set_tcp(TOOL)
    plant.set_payload(0.5, (0.0, 0.0, 0.0))
    start = plant.q.copy()
    plant.drive(start + 0.3, STILL)
    plant.lay_out(Task(7, "cir"))
    assert plant.part == "cir"
    assert plant.truth()["task"]["seed"] == 7
    assert len(heard) == 1
    assert heard[0] == pytest.approx(start, abs=1e-3)
    assert not plant.qd.any()
    assert plant.tcp_offset == TOOL
    plant.zero_ft()  # what stands still and is not what was configured is zeroed like any other
    assert hold(plant, 400)[:3] == pytest.approx(np.zeros(3), abs=0.25)


def test_a_task_that_no_world_can_be_built_from_is_refused_and_changes_nothing(plant):
    with pytest.raises(ValueError, match="clearance_m"):
        plant.lay_out(Task(0, clearance_m=1.0))
    assert plant.truth()["task"]["clearance_m"] != 1.0


def test_a_plant_is_one_arm():
    with pytest.raises(ValueError, match="one arm"):
        Plant(World(2))


def test_servo_torques_carry_the_payload_and_stay_within_what_the_joints_can(plant):
    hold(plant, 100)
    lift = kinematics.jacobian(plant.q, [0.0, 0.0, scene.PAYLOAD_COM_M])[2]
    assert plant.joint_torques() == pytest.approx(lift * WEIGHT_N, abs=0.05)
    plant.drive(plant.q + 1.0, STILL)
    assert (np.abs(plant.joint_torques()) <= kinematics.JOINT_TORQUE_NM).all()


def test_the_estimate_is_the_cameras(plant):
    assert np.linalg.norm(plant.estimate - plant.truth()["hole_position"]) < 0.01


def test_an_episode_lays_out_the_errors_of_its_plant(plant):
    errors = PlantErrors(hole_tilt_deg=1.0, ft_left_n=2.0, tcp_shift_m=1e-3, payload_mass_scale=1.2)
    plant.lay_out(Task(3, plant=errors))
    plant.zero_ft()
    assert np.linalg.norm(hold(plant, 600)[:3]) == pytest.approx(2.0, abs=0.2)
    world = World(1)
    world.reset(np.array([0]), [Task(3, plant=errors)])
    assert plant.world.model().body("peg").pos == pytest.approx(world.model().body("peg").pos)
    assert (plant.world.data().mocap_quat == world.data().mocap_quat).all()
    assert plant.truth()["task"]["plant"] == errors.to_json()
