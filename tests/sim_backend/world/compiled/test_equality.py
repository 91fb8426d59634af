"""The compiled tick computes what numpy computes, bit for bit."""

import numpy as np
import pytest

from sim_backend.world import compiled, engine, kinematics, scene
from sim_backend.world.arm import PROTECTIVE_ERROR_RAD, ArmController
from sim_backend.world.conditions import draw
from sim_backend.world.joint_sense import JointSense
from sim_backend.world.sensor import DRIFT_TICKS, RANGE, ForceTorqueSensor
from sim_backend.world.telling import REPORT
from sim_backend.world.world import World
from sim_backend.zenoh_cell.cell import SimulatedCell
from tests.sim_backend.world.compiled.twins import (
    arrays,
    assert_equal,
    needs_the_extension,
    of_arm,
    of_sensor,
    of_world,
    twins,
)
from wire import pose
from wire.law import ControlLimits
from wire.limits import WORKSPACE_M
from wire.plant import PlantErrors
from wire.records import Program, StopReason
from wire.task import Task

pytestmark = needs_the_extension

STIFFNESS = np.array([2500.0, 2500.0, 3000.0, 5.0, 5.0, 8.0])
DAMPING = np.array([320.0, 320.0, 400.0, 1.0, 1.0, 0.5])
INERTIA = np.array([2.5, 2.5, 2.5, 0.06, 0.06, 0.03])
LIMITS = ControlLimits(WORKSPACE_M, 30.0, target_age_s=0.06)
SIZES = (1, 7, 64, 256)
TARGET_TICKS = 20


def play(worlds: tuple[World, World], ticks: int, seed: int = 0, together: int = 1) -> set[tuple[int, int]]:
    """Play the same in two worlds, `together` ticks at a time, and compare them after each; return the programs and
    reasons seen.

    The arms search about their holes in contact. They are stopped with and without sight, pushed, placed anew and
    engaged again; holes slip; targets are bad or stay out.
    """
    n = worlds[0].n
    rng = np.random.default_rng(seed)
    everyone, seen = np.arange(n), set[tuple[int, int]]()
    readings = np.zeros((2, together, n, 6))
    for tick in range(0, ticks, together):
        if tick % TARGET_TICKS == 0:
            fate = rng.uniform(size=n)
            step, turn = rng.normal(size=(n, 3)) * [1e-3, 1e-3, 2e-3], rng.normal(size=(n, 4)) * 4e-3
            slip, push = rng.normal(size=(n, 3)) * 1e-3, rng.normal(size=(n, 6)) * 0.04
            step[fate > 0.98] *= 20.0
            new = [Task(int(rng.integers(1000)), randomise_plant=True) for _ in everyone]
            for world in worlds:
                arm = world.arm
                world.engage(everyone[arm.program == Program.IDLE], STIFFNESS, DAMPING, INERTIA, LIMITS)
                position = arm.target_position + step - [0.0, 0.0, 5e-4]
                quaternion = arm.target_quaternion + turn
                quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
                led = everyone[(fate > 0.06) & (arm.program == Program.ENGAGED)]
                arm.set_target(led, position[led], quaternion[led])
                world.stop(everyone[(fate > 0.10) & (fate < 0.13)])
                world.stop(everyone[(fate > 0.13) & (fate < 0.16)], blind=True)
                world.move_hole(everyone[fate < 0.2], (world.hole_position + slip)[fate < 0.2], slip[fate < 0.2, 0])
                world._qpos[(fate > 0.2) & (fate < 0.22), :6] += push[(fate > 0.2) & (fate < 0.22)]
                anew = everyone[((fate > 0.22) & (fate < 0.24)) | (arm.program == Program.PROTECTIVE_STOP)]
                if anew.size and tick % (5 * TARGET_TICKS) == 0:
                    world.reset(anew, [new[cell] for cell in anew])
                    above = world.hole_position[anew] + [0.0, 0.0, 3e-3]
                    world.place(anew, above, world.hole_yaw[anew])
                    world.zero_ft(anew)
        for world, row in zip(worlds, readings, strict=True):
            if together == 1:
                world.tick()
            else:
                world.advance(row)
        assert_equal(of_world(worlds[0]), of_world(worlds[1]), f"tick {tick} of {n} cells")
        np.testing.assert_array_equal(*readings)
        seen |= set(zip(worlds[0].arm.program.tolist(), worlds[0].arm.stop_reason.tolist(), strict=True))
    return seen


def start(n: int, ticks: int, together: int = 1) -> set[tuple[int, int]]:
    worlds = twins(lambda: World(n, threads=2))
    everyone = np.arange(n)
    for world in worlds:
        world.reset(everyone, [Task(seed, randomise_plant=bool(seed % 2)) for seed in range(n)])
        world.place(everyone, world.hole_position + np.array([0.0, 0.0, 2e-3]), world.hole_yaw)
        world.zero_ft(everyone)
    return play(worlds, ticks, n, together)


@pytest.mark.parametrize(("n", "ticks"), [(1, 1200), (7, 500), (64, 120), (256, 45)])
def test_worlds_are_the_same_bit_for_bit(n: int, ticks: int) -> None:
    programs = {program for program, _ in start(n, ticks)}
    assert {Program.ENGAGED, Program.STOPPING} <= programs


@pytest.mark.parametrize(("n", "ticks", "together"), [(1, 1200, 20), (7, 500, 10), (64, 120, 20), (256, 40, 20)])
def test_ticks_in_one_call_are_the_same_bit_for_bit(n: int, ticks: int, together: int) -> None:
    assert engine.obstacle() == ""
    programs = {program for program, _ in start(n, ticks, together)}
    assert {Program.ENGAGED, Program.STOPPING} <= programs


@pytest.mark.nightly
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("together", [1, TARGET_TICKS])
def test_worlds_are_the_same_bit_for_bit_over_a_million_ticks_of_a_cell(n: int, together: int) -> None:
    seen = start(n, 1_000_000 // n, together)
    assert {program for program, _ in seen} == set(Program)
    assert {
        StopReason.COMMAND,
        StopReason.FORCE_CEILING,
        StopReason.TARGET_AGE,
        StopReason.TARGET_REJECTED,
        StopReason.PROTECTIVE_FORCE,
    } <= {reason for _, reason in seen}


def test_arms_are_the_same_bit_for_bit_whatever_they_measure() -> None:
    """Measured values at random, far beyond what an arm can do: every limit, and numbers that are none."""
    n, ticks = 64, 1000
    rng = np.random.default_rng(1)
    arms = twins(lambda: ArmController(n, scene.TCP_OFFSET_M, (0.9, 0.05), np.full(6, 2e3), np.full(6, 60.0)))
    everyone, seen = np.arange(n), set[tuple[int, int]]()
    near = np.array([-0.2, -1.9, -1.7, -1.1, 1.57, 0.0])
    far = ControlLimits(((-9.0, -9.0, -9.0), (9.0, 9.0, 9.0)), 30.0, (0.5, 3.0), (1.0, 3.0), target_age_s=0.01)
    for tick in range(ticks):
        fate = rng.uniform(size=n)
        joints = near + rng.normal(size=(n, 6)) * 0.7
        joints[fate < 0.02, 4] = rng.normal() * 1e-3
        joints[(fate > 0.02) & (fate < 0.04), 3] = 6.4
        placed = everyone[rng.uniform(size=n) < (1.0 if tick == 0 else 0.01)]
        delay = rng.integers(0, 4, n)
        wrench = rng.normal(size=(n, 6)) * rng.choice([0.1, 5.0, 20.0, 100.0], size=(n, 1), p=[0.6, 0.36, 0.03, 0.01])
        wrench[(fate > 0.04) & (fate < 0.045), 1] = np.nan
        wrench[(fate > 0.045) & (fate < 0.05), 5] = np.inf
        lag = rng.normal(size=(n, 6)) * PROTECTIVE_ERROR_RAD * np.where(fate > 0.995, 1.0, 0.05)[:, None]
        position, orientation = rng.normal(size=(n, 3)), rng.normal(size=(n, 4))
        orientation /= np.linalg.norm(orientation, axis=1, keepdims=True)
        saturated = (fate > 0.05) & (fate < 0.055)
        target, turn = rng.normal(size=(n, 3)) * 0.02, rng.normal(size=(n, 4)) * 0.05
        set_points = []
        for arm in arms:
            arm.place(placed, joints[placed], delay[placed])
            arm.unlock(everyone[arm.program == Program.PROTECTIVE_STOP])
            idle = everyone[(arm.program == Program.IDLE) & (fate < 0.3)]
            arm.engage(idle, STIFFNESS, DAMPING, INERTIA, far)
            arm.stop(everyone[fate > 0.99], StopReason.COMMAND, blind=True)
            led = everyone[(fate > 0.4) & (arm.program == Program.ENGAGED)]
            quaternion = arm.target_quaternion + turn
            quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
            arm.set_target(led, (arm.target_position + target)[led], quaternion[led])
            set_points.append(arm.update(arm.joints + lag, wrench, position, orientation, saturated))
        one, other = (of_arm(arm) | {"set_points": found} for arm, found in zip(arms, set_points, strict=True))
        assert_equal(one, other, tick)
        seen |= set(zip(arms[0].program.tolist(), arms[0].stop_reason.tolist(), strict=True))
    assert {program for program, _ in seen} == set(Program)
    assert {reason for _, reason in seen} >= {
        StopReason.COMMAND,
        StopReason.FORCE_CEILING,
        StopReason.TARGET_AGE,
        StopReason.JOINT_LIMIT,
        StopReason.KINEMATICS,
        StopReason.PROTECTIVE_FORCE,
    }


@pytest.mark.parametrize("odd", [np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, -0.0])
@pytest.mark.parametrize("blind", [True, False, None], ids=["a blind stop", "a stop", "no stop"])
@pytest.mark.parametrize("speed", [(1e-4, 1e-3), (1.0, 3.0)], ids=["above its speed", "below it"])
def test_numbers_that_no_arm_measures_lead_both_to_the_same(
    speed: tuple[float, float], blind: bool | None, odd: float
) -> None:
    """The first of three arms has an odd number once, in one place after the other; the others are as ever."""
    limits = ControlLimits(((-9.0,) * 3, (9.0,) * 3), 30.0, speed, (0.5, 3.0))
    everyone, joints = np.arange(3), np.tile([-0.2, -1.9, -1.7, -1.1, 1.57, 0.0], (3, 1))
    for place in range(22):
        arms = twins(lambda: ArmController(3, scene.TCP_OFFSET_M, (0.9, 0.05), np.full(6, 2e3), np.full(6, 60.0)))
        for arm in arms:
            arm.place(everyone, joints, np.zeros(3, np.int64))
            arm.engage(everyone, STIFFNESS, DAMPING, INERTIA, limits)
            if blind is not None:
                arm.stop(everyone, StopReason.COMMAND, blind=blind)
        for tick in range(4):
            found = []
            for arm in arms:
                position = arm.reference.position + 0.01
                measured = [arm.joints.copy(), np.full((3, 6), 0.5), position, arm.reference.quaternion.copy()]
                places = [(one, k) for one in (*measured, arm.target_position) for k in range(one.shape[1])]
                if tick == 1:
                    array, k = places[place]
                    array[0, k] = odd
                with np.errstate(all="ignore"):
                    found.append(of_arm(arm) | {"set_points": arm.update(*measured)})
            assert_equal(*found, f"tick {tick}, place {place}")


def test_sensors_are_the_same_bit_for_bit() -> None:
    n = 16
    rng = np.random.default_rng(2)
    sensors = twins(lambda: ForceTorqueSensor(n, 0.93, (0.0, 0.0, 0.05), (0.0, 0.0, 0.2)))
    for sensor in sensors:
        for cell in range(n):
            plant = PlantErrors(ft_gain_error=0.05 * cell, ft_left_n=1.0, ft_delay_ticks=cell) if cell % 2 else None
            sensor.reset(cell, draw(Task(cell, randomise_plant=True, plant=plant)))
        sensor._tick[::5] = DRIFT_TICKS - 100
    for tick in range(400):
        carried = rng.normal(size=(n, 6)) * rng.choice([1.0, 10.0, 30.0], size=(n, 1))
        carried[tick % n, 2] = np.nan if tick % 50 == 49 else carried[tick % n, 2]
        rotation = np.asarray(pose.rotation_from_rotvec(rng.normal(size=(n, 3)) * 2.0))
        levers = rng.normal(size=6) * 0.1
        for sensor in sensors:
            if tick % 100 == 99:
                sensor.configure(abs(float(levers[0])) * 10.0, levers[:3], levers[3:], rotation)
            if tick % 70 == 69:
                sensor.zero(np.arange(0, n, 3))
            if tick % 90 == 89:
                sensor.reset(3, draw(Task(tick)))
            sensor.read(carried, rotation)
        assert_equal(of_sensor(sensors[0]), of_sensor(sensors[1]), tick)
    assert sensors[0].saturated.any()
    assert not sensors[0].saturated.all()
    assert not (np.abs(sensors[0].raw) > RANGE).any()


@pytest.mark.parametrize("point", [(0.0, 0.0, scene.TCP_OFFSET_M), (0.03, -0.02, 0.15)])
def test_drives_feel_the_same_bit_for_bit(point: tuple[float, float, float]) -> None:
    worlds, senses = twins(lambda: World(1)), twins(JointSense)
    only = np.array([0])
    for world, sense in zip(worlds, senses, strict=True):
        world.reset(only, [Task(4)])
        world.place(only, world.hole_position + np.array([0.0, 0.02, 1e-3]), world.hole_yaw)
        world.zero_ft(only)
        world.engage(only, STIFFNESS, DAMPING, INERTIA, LIMITS)
        sense.begin(4)
    for tick in range(600):
        for world, sense in zip(worlds, senses, strict=True):
            if tick % TARGET_TICKS == 0:
                lower = world.arm.target_position - [1e-4, 0.0, 2e-4]
                world.arm.set_target(only, lower, world.arm.target_quaternion)
            world.tick()
            payload = 0.9 if tick < 300 else 1.4
            sense.read(world, payload, (0.01, 0.0, 0.05), point)
        assert_equal(arrays(senses[0]), arrays(senses[1]), tick)
    assert np.linalg.norm(senses[0].force) > 5.0


def test_records_of_a_cell_are_the_same_byte_for_byte() -> None:
    cells = twins(lambda: SimulatedCell("tr", epoch=1))
    for cell in cells:
        cell.reset(Task(5))
    for _ in range(300):
        one, other = (cell.tick().tobytes() for cell in cells)
        assert one == other


def test_what_a_world_tells_is_in_the_order_of_the_extension() -> None:
    assert compiled.tick is not None
    assert compiled.tick.REPORT == REPORT


@pytest.mark.parametrize("joints", [np.zeros(6), np.array([-0.2, -1.9, 0.0, -1.1, 1.57, 0.0])])
def test_a_singular_arm_is_held_likewise(joints: np.ndarray) -> None:
    arms = twins(lambda: ArmController(1, scene.TCP_OFFSET_M, (0.9, 0.05), np.full(6, 2e3), np.full(6, 60.0)))
    assert kinematics.singularity_margin(joints).min() < 1e-9
    for arm in arms:
        arm.place(np.array([0]), joints[None], np.array([0]))
        arm.engage(np.array([0]), STIFFNESS, DAMPING, INERTIA, LIMITS)
        for _ in range(25):
            arm.update(joints[None], np.full((1, 6), 0.5), np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]))
    assert arms[0].stop_reason[0] == StopReason.KINEMATICS
    assert_equal(of_arm(arms[0]), of_arm(arms[1]), "the end")
