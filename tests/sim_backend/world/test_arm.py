"""The arm controller with an arm that follows perfectly: its measured joints are its set-points."""

from dataclasses import replace

import numpy as np
import pytest

from sim_backend.world import kinematics, quaternion, scene
from sim_backend.world.arm import (
    KINEMATICS_TICKS,
    MIN_PROTECTIVE_STOP_S,
    PROTECTIVE_ERROR_RAD,
    PROTECTIVE_FORCE_N,
    STOP_S,
    ArmController,
)
from wire import pose
from wire.law import ControlLimits
from wire.limits import FORCE_CEILING_N, WORKSPACE_M
from wire.records import TICK_S, Program, StopReason

STIFFNESS = np.array([2500.0, 2500.0, 3000.0, 5.0, 5.0, 8.0])
DAMPING = np.array([320.0, 320.0, 400.0, 1.0, 1.0, 0.5])
INERTIA = np.array([2.5, 2.5, 2.5, 0.06, 0.06, 0.03])
START = np.array([0.3, -0.11, 0.18])
NEAR = np.array([-0.2, -1.9, -1.7, -1.1, 1.57, 0.0])
TCP = np.array([0.0, 0.0, scene.TCP_OFFSET_M])
ONLY = np.array([0])
OF_TRAINING = ControlLimits(WORKSPACE_M, FORCE_CEILING_N)
DOWN = quaternion.from_rotvec(np.array([[np.pi, 0.0, 0.0]]))


def joints_at(position, rotation=None):
    rotation = pose.tool_down(0.0) if rotation is None else rotation
    return kinematics.inverse(position - rotation @ TCP, rotation, NEAR)


class Bench:
    """One or more controllers and the ideal arms that they drive."""

    def __init__(self, n=1, delay=0, engage=True, limits=None, joints=None):
        self.arm = ArmController(n, scene.TCP_OFFSET_M, (0.0, 0.0), np.full(6, 1e3), np.zeros(6))
        self.cells = np.arange(n)
        self.wrench = np.zeros((n, 6))
        self.joints = np.tile(joints_at(START) if joints is None else joints, (n, 1))
        self.arm.place(self.cells, self.joints, np.full(n, delay))
        self.measure()
        if engage:
            self.arm.engage(self.cells, STIFFNESS, DAMPING, INERTIA, limits or OF_TRAINING)

    def measure(self):
        flange, rotation = kinematics.forward(self.joints)
        self.position = flange + rotation @ TCP
        self.orientation = quaternion.from_rotvec(pose.rotvec_from_rotation(rotation))

    def run(self, ticks):
        for _ in range(ticks):
            self.joints = self.arm.update(self.joints, self.wrench, self.position, self.orientation)
            self.measure()

    def target(self, position, orientation=DOWN):
        n = self.arm.n
        return self.arm.set_target(
            self.cells, np.broadcast_to(position, (n, 3)).astype(float), np.broadcast_to(orientation, (n, 4))
        )

    @property
    def state(self):
        return Program(self.arm.program[0]), StopReason(self.arm.stop_reason[0])


@pytest.mark.parametrize(("pace", "micrometres", "milliradians"), [(0.3, 15, 0.03), (1.0, 150, 0.3)])
def test_the_joints_are_the_inverse_kinematics_of_the_reference_along_a_path(pace, micrometres, milliradians):
    """At 25 mm/s and 0.17 rad/s, and at 81 mm/s and 0.55 rad/s, between two exact solutions."""
    bench = Bench(limits=replace(OF_TRAINING, max_speed=(0.25, 2.0)))
    worst = farthest = 0.0
    position = START.copy()
    for step in range(round(110 / pace)):
        angle = 0.06 * pace * step
        position = START + np.array([0.05 * np.sin(angle), 0.04 * (1 - np.cos(angle)), -0.03 * np.sin(0.5 * angle)])
        turn = pose.rotation_from_rotvec([0.1 * np.sin(angle), 0.1 * np.sin(2 * angle), 0.3 * np.sin(angle)])
        rotation = turn @ pose.tool_down(0.0)
        assert bench.target(position, quaternion.from_rotvec(pose.rotvec_from_rotation(rotation[None]))).all()
        for _ in range(20):
            bench.run(1)
            reference = bench.arm.reference
            worst = max(worst, np.abs(bench.position - reference.position).max())
            farthest = max(farthest, np.linalg.norm(bench.position - START))
            tilt = np.abs(quaternion.between(bench.orientation, reference.quaternion)).max()
            assert tilt < 1e-3 * milliradians
    assert worst < 1e-6 * micrometres
    assert farthest > 0.05  # it did go somewhere
    rotation = pose.rotation_from_rotvec(quaternion.to_rotvec(bench.arm.reference.quaternion))[0]
    exact = joints_at(bench.arm.reference.position[0], rotation)
    assert bench.joints[0] == pytest.approx(exact, abs=1e-5 * micrometres)


def test_at_rest_the_joints_are_exactly_on_the_target():
    bench = Bench(limits=replace(OF_TRAINING, target_age_s=10.0))
    target = START + np.array([0.005, -0.003, 0.004])
    bench.target(target)
    bench.run(1500)
    assert bench.position[0] == pytest.approx(target, abs=1e-7)


def test_idle_arms_ignore_targets_and_forces():
    bench = Bench(engage=False)
    assert not bench.target(START + np.array([0.01, 0, 0])).any()
    bench.wrench[:] = 20.0
    bench.run(50)
    assert bench.position[0] == pytest.approx(START, abs=1e-9)
    assert bench.state == (Program.IDLE, StopReason.NONE)


@pytest.mark.parametrize(
    ("position", "orientation"),
    [
        (START + np.array([0.0, 0.0, -0.2]), DOWN),
        (START + np.array([0.0125, 0.0, 0.0]), DOWN),
        ([np.nan, 0.0, 0.2], DOWN),
        ([np.inf, 0.0, 0.2], DOWN),
        (START, np.full((1, 4), np.nan)),
        (START, quaternion.from_rotvec(pose.rotvec_from_rotation(pose.tool_down(np.array([0.31]))))),
    ],
    ids=["workspace", "step", "nan", "inf", "nan turn", "turn"],
)
def test_a_bad_target_stops_the_program_and_moves_nothing(position, orientation):
    bench = Bench()
    with np.errstate(invalid="ignore"):
        assert not bench.target(position, orientation).any()
    assert bench.state == (Program.STOPPING, StopReason.TARGET_REJECTED)
    bench.run(100)
    assert bench.state == (Program.IDLE, StopReason.TARGET_REJECTED)
    assert bench.position[0] == pytest.approx(START, abs=1e-9)


def test_every_wall_of_the_workspace_is_a_limit():
    lower, upper = START - 0.005, START + 0.005
    box = (tuple(lower), tuple(upper))
    for axis in range(3):
        for sign in (-1, 1):
            for reach, good in ((0.0049, True), (0.0051, False)):
                bench = Bench(limits=replace(OF_TRAINING, workspace=box))
                target = START.copy()
                target[axis] += sign * reach
                assert bench.target(target).all() == good


def test_the_step_limit_counts_from_a_target_that_still_waits():
    bench = Bench(delay=10, limits=replace(OF_TRAINING, max_step=(0.004, 0.3)))
    for k in range(1, 4):
        assert bench.target(START + np.array([0.003 * k, 0, 0])).all()
    assert not bench.target(START + np.array([0.003 * 3 + 0.005, 0, 0])).any()


@pytest.mark.parametrize("delay", [0, 1, 5, 10])
def test_a_target_takes_effect_exactly_its_delay_later(delay):
    bench = Bench(delay=delay)
    bench.run(3)
    bench.target(START + np.array([0.004, 0, 0]))
    ticks = 0
    while bench.arm.reference.position[0, 0] == START[0] or bench.arm.target_position[0, 0] == START[0]:
        bench.run(1)
        ticks += 1
        assert ticks < 20
    assert ticks == delay + 1


def test_without_targets_the_program_stops_at_the_age_limit():
    bench = Bench(limits=replace(OF_TRAINING, target_age_s=0.1))
    bench.run(30)
    bench.target(START)  # a target renews it
    bench.run(50)
    assert bench.state[0] is Program.ENGAGED
    bench.run(1)
    assert bench.state == (Program.STOPPING, StopReason.TARGET_AGE)


def test_the_controller_stops_at_its_own_force_ceiling_on_the_sample_that_reaches_it():
    bench = Bench()
    bench.wrench[0, :3] = [0.0, 24.0, 17.9]  # 29.94 N resultant
    bench.run(1)
    assert bench.state[0] is Program.ENGAGED
    bench.wrench[0, :3] = [0.0, 24.0, 18.01]
    bench.run(1)
    assert bench.state == (Program.STOPPING, StopReason.FORCE_CEILING)
    assert bench.arm.peak_force[0] == pytest.approx(np.hypot(24.0, 18.01))


@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_a_stop_ends_in_time_whatever_the_noise_and_the_arm_stays(noise):
    bench = Bench(limits=replace(OF_TRAINING, max_speed=(0.25, 2.0)))
    rng = np.random.default_rng(0)
    for k in range(20):
        bench.target(START + np.array([0.004 * (k + 1), 0, 0]))
        bench.run(10)
    assert np.linalg.norm(bench.arm.reference.twist[0, :3]) > 0.1
    bench.arm.stop(ONLY, StopReason.COMMAND)
    for _ in range(round(STOP_S / TICK_S) + 1):
        bench.wrench[:] = noise * rng.normal(size=(1, 6)) * [1, 1, 1, 0.07, 0.07, 0.07]
        bench.run(1)
    assert bench.state == (Program.IDLE, StopReason.COMMAND)
    assert not bench.arm.reference.twist.any()
    still = bench.position.copy()
    bench.wrench[:] = 3.0
    bench.run(200)
    assert bench.position == pytest.approx(still, abs=20e-6)  # the last correction of the joints


def test_a_stop_under_load_gives_way_before_it_holds():
    bench = Bench()
    bench.wrench[0, 2] = 40.0  # pressed upwards
    bench.run(2)
    assert bench.state[1] is StopReason.FORCE_CEILING
    for _ in range(60):
        # a wall of 17 kN/m, 2.3 mm in
        bench.wrench[0, 2] = max(0.0, 40.0 - 17e3 * (bench.position[0, 2] - START[2]))
        bench.run(1)
    assert bench.wrench[0, 2] < 10.0


def test_a_stopped_program_obeys_no_target_until_it_is_engaged_again():
    bench = Bench()
    bench.arm.stop(ONLY, StopReason.COMMAND)
    assert not bench.arm.engage(ONLY, STIFFNESS, DAMPING, INERTIA, OF_TRAINING).any()  # not while it moves
    assert not bench.target(START + np.array([0.01, 0, 0])).any()
    bench.run(60)
    assert not bench.target(START + np.array([0.01, 0, 0])).any()
    assert bench.arm.engage(ONLY, STIFFNESS, DAMPING, INERTIA, OF_TRAINING).all()
    assert bench.state == (Program.ENGAGED, StopReason.NONE)
    bench.run(50)
    assert bench.position[0] == pytest.approx(START, abs=1e-9)
    assert bench.target(START + np.array([0.01, 0, 0])).all()
    bench.run(300)
    assert bench.position[0, 0] > START[0] + 0.009


def test_a_second_stop_does_not_change_the_reason():
    bench = Bench()
    bench.arm.stop(ONLY, StopReason.LEASE)
    bench.arm.stop(ONLY, StopReason.COMMAND)
    assert bench.state[1] is StopReason.LEASE


def test_the_arm_stops_before_the_elbow_is_straight_and_stands():
    free = replace(OF_TRAINING, workspace=((-1, -1, -1), (1, 1, 1)), max_speed=(0.1, 1.0))
    bench = Bench(limits=free)
    position, fastest = START.copy(), 0.0
    for _ in range(100):
        position = position + np.array([0.008, 0.0, 0.0])
        if not bench.target(position).all():
            break
        for _ in range(40):
            before = bench.joints.copy()
            bench.run(1)
            fastest = max(fastest, np.abs(bench.joints - before)[0, 2] / TICK_S)
    assert bench.state[1] is StopReason.KINEMATICS
    assert kinematics.singularity_margin(bench.joints[0]).min() > 0.03
    assert fastest <= 2 * kinematics.JOINT_SPEED_RAD_S[2]  # moving and correcting
    bench.run(100)
    still = bench.joints.copy()
    bench.wrench[:] = 5.0
    bench.run(100)
    assert bench.joints == pytest.approx(still, abs=1e-5)


def test_the_arm_stops_at_the_end_of_a_joints_range():
    near_end = joints_at(START)
    near_end[0] += 2 * np.pi if near_end[0] < 0 else -2 * np.pi
    wide = replace(OF_TRAINING, workspace=((-1, -1, -1), (1, 1, 1)), max_step=(0.05, 0.3))
    bench = Bench(joints=near_end, limits=wide)
    flange, rotation = kinematics.forward(near_end)
    position = flange + rotation @ TCP
    angle = np.arctan2(position[1], position[0])
    radius = np.hypot(position[0], position[1])
    for _ in range(60):
        angle += 0.05 * np.sign(near_end[0])
        if not bench.target([radius * np.cos(angle), radius * np.sin(angle), position[2]]).all():
            break
        bench.run(100)
    assert bench.state[1] is StopReason.JOINT_LIMIT
    assert np.abs(bench.joints[0, 0]) < 2 * np.pi + 0.02


@pytest.mark.parametrize("cause", ["force", "lag"])
def test_a_protective_stop_freezes_the_arm_and_unlocks_after_five_seconds_only(cause):
    bench = Bench()
    if cause == "force":
        bench.wrench[0, 0] = PROTECTIVE_FORCE_N
        bench.run(1)
        bench.wrench[:] = 0.0
    else:
        bench.joints[0, 1] += PROTECTIVE_ERROR_RAD + 1e-3
        bench.run(1)
    assert bench.state == (Program.PROTECTIVE_STOP, StopReason.PROTECTIVE_FORCE)
    still = bench.position.copy()
    bench.wrench[:] = 8.0
    bench.run(round(MIN_PROTECTIVE_STOP_S / TICK_S) - 2)
    assert bench.position == pytest.approx(still, abs=1e-9)
    assert not bench.target(START).any()
    assert not bench.arm.engage(ONLY, STIFFNESS, DAMPING, INERTIA, OF_TRAINING).any()
    bench.arm.unlock(ONLY)
    assert bench.state[0] is Program.PROTECTIVE_STOP
    bench.run(3)
    bench.arm.unlock(ONLY)
    assert bench.state[0] is Program.IDLE
    bench.wrench[:] = 0.0
    assert bench.arm.engage(ONLY, STIFFNESS, DAMPING, INERTIA, OF_TRAINING).all()
    bench.run(100)
    assert bench.position == pytest.approx(still, abs=1e-7)  # engaging moves nothing


def test_a_fault_of_one_arm_does_not_reach_into_another():
    pair, alone = Bench(2), Bench()
    for k in range(15):
        for bench in (pair, alone):
            bench.target(START + np.array([0.003 * k, 0.002 * k, 0]))
        if k == 7:
            pair.joints[1, 2] += 1.0  # a protective stop, out of step with everything
        pair.run(7)
        alone.run(7)
        assert (pair.joints[0] == alone.joints[0]).all()
    assert pair.arm.program.tolist() == [Program.ENGAGED, Program.PROTECTIVE_STOP]


def test_arms_placed_at_different_times_keep_their_own_time():
    pair, alone = Bench(2), Bench()
    pair.target(START + np.array([0.01, 0, 0]))
    pair.run(KINEMATICS_TICKS + 7)
    pair.joints[1] = joints_at(START)
    pair.arm.place(np.array([1]), pair.joints[1:], np.zeros(1, np.int64))
    pair.measure()
    pair.arm.engage(np.array([1]), STIFFNESS, DAMPING, INERTIA, OF_TRAINING)
    for bench in (pair, alone):
        for k in range(4):
            bench.arm.set_target(bench.cells[-1:], START[None] + [[0.004 * k, 0, -0.003 * k]], DOWN)
            bench.run(33)
    assert (pair.joints[1] == alone.joints[0]).all()


@pytest.mark.parametrize("channel", range(6))
def test_a_load_that_is_no_number_stops_the_program_and_the_arm_stays_a_number(channel):
    bench = Bench()
    bench.run(5)
    bench.wrench[0, channel] = np.nan
    bench.run(100)
    assert bench.state == (Program.IDLE, StopReason.FORCE_CEILING)
    assert np.isfinite(bench.joints).all()
    assert bench.position[0] == pytest.approx(START, abs=1e-4)


def test_a_saturated_sensor_stops_the_program_of_its_own_arm_only():
    bench = Bench(n=2)
    bench.arm.update(bench.joints, bench.wrench, bench.position, bench.orientation, np.array([True, False]))
    assert bench.arm.program.tolist() == [Program.STOPPING, Program.ENGAGED]
    assert bench.state[1] is StopReason.FORCE_CEILING


@pytest.mark.parametrize("first", [None, StopReason.FORCE_CEILING])
def test_a_blind_stop_does_not_yield_to_the_sensor_even_if_a_stop_was_under_way(first):
    """A sensor with the wrong sign says that the arm is pulled on, and more so the further it gives way."""
    moved = {}
    for blind in (False, True):
        bench = Bench()
        bench.run(20)
        if first is not None:
            bench.arm.stop(ONLY, first)
        bench.arm.stop(ONLY, StopReason.COMMAND, blind=blind)
        bench.wrench[0, 2] = -29.0
        bench.run(round(STOP_S / TICK_S) + 1)
        assert bench.state[0] is Program.IDLE
        moved[blind] = START[2] - bench.arm.reference.position[0, 2]
    assert moved[False] > 2e-3
    assert moved[True] == pytest.approx(0.0, abs=1e-6)
    assert bench.arm.engage(ONLY, STIFFNESS, DAMPING, INERTIA, OF_TRAINING)[0]
    bench.run(20)
    assert bench.arm.reference.twist[0, 2] < 0.0, "the next law feels again"


def test_a_blind_stop_lets_the_reference_follow_an_arm_that_is_held_back():
    """The servos of an arm that cannot follow push; the reference that comes back to the arm takes the push away."""
    bench = Bench()
    bench.run(5)
    lag = np.array([0.002, -0.001, 0.003])
    bench.arm.stop(ONLY, StopReason.COMMAND, blind=True)
    for _ in range(round(STOP_S / TICK_S) - 1):
        held = bench.arm.update(bench.joints, bench.wrench, START + lag[None], bench.orientation)
        assert np.isfinite(held).all()
    assert bench.arm.reference.position[0] == pytest.approx(START + lag, abs=2e-4)
    assert np.linalg.norm(bench.arm.reference.twist[0, :3]) < 5e-3
