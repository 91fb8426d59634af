"""Errors of a plant do to the world what their names say, and nothing else."""

import dataclasses
from typing import Any

import mujoco
import numpy as np
import pytest

from sim_backend.world import scene
from sim_backend.world.conditions import draw
from sim_backend.world.errors import JITTERS
from sim_backend.world.world import World
from tests.sim_backend.world.compiled.twins import assert_equal, told
from tests.sim_backend.world.plants import EVERY, ODD_PEG
from wire import pose
from wire.arrays import FloatArray
from wire.law import ControlLimits
from wire.plant import PlantErrors
from wire.task import Task

N = 4
CELLS = np.arange(N)
WEIGHT_N = scene.PAYLOAD_KG * 9.81
FREE = ControlLimits(max_step=(1.0, 3.0), force_ceiling_n=100.0, target_age_s=60.0, workspace=((-1, -1, -1), (1, 1, 1)))
UP = np.array([0.0, 0.0, 1.0])
PRESSED = np.array([0.045, 0.0, -1e-3])
"""Place beside the hole, 1 mm below the block's surface."""


def worlds(n: int = N, **errors: Any) -> World:
    """Cells of seeds 0, 1, …, each with these errors of its plant."""
    world = World(n, plant=PlantErrors(**errors))
    world.reset(np.arange(n), tasks(n, **errors))
    return world


def tasks(n: int = N, **errors: Any) -> list[Task]:
    return [Task(seed, plant=PlantErrors(**errors)) for seed in range(n)]


def degrees(one: FloatArray, other: FloatArray) -> FloatArray:
    """Angles (n,) between directions (n, 3)."""
    return np.rad2deg(np.arctan2(np.linalg.norm(np.cross(one, other), axis=-1), (one * other).sum(-1)))


def readings(world: World, ticks: int = 300) -> tuple[FloatArray, FloatArray]:
    """Mean raw and compensated readings (n, 6) of arms at rest, without the bias and the noise of those ticks."""
    raw, wrench = np.zeros((2, ticks, world.n, 6))
    for tick in range(ticks):
        world.tick()
        raw[tick], wrench[tick] = world.sensor.raw, world.sensor.wrench
    noise = [episode.wrench_noise[:ticks].mean(0) + episode.bias for episode in world._episodes]
    return raw.mean(0) - np.array(noise), wrench.mean(0)


def body(world: World, cell: int, name: str) -> tuple[FloatArray, FloatArray]:
    """Position and rotation of a body in MuJoCo."""
    model, data = world.model(cell), world.data(cell)
    mujoco.mj_forward(model, data)
    found = data.body(name)
    return found.xpos.copy(), found.xmat.reshape(3, 3).copy()


def test_a_hole_is_tilted_about_a_level_axis_through_its_mouth() -> None:
    world, level = worlds(hole_tilt_deg=1.5), worlds()
    found = [body(world, cell, "block") for cell in CELLS]
    assert degrees(np.array([turn[:, 2] for _, turn in found]), UP) == pytest.approx(np.full(N, 1.5))
    assert np.array([at for at, _ in found]) == pytest.approx(level.hole_position)
    assert world.hole_yaw == pytest.approx(level.hole_yaw)
    axes = np.array([np.cross(UP, turn[:, 2]) for _, turn in found])
    assert (degrees(axes[1:], axes[:1]) > 1.0).all()  # each seed has a direction of its own


def test_depth_and_offset_are_measured_in_the_tilted_hole() -> None:
    world = worlds(hole_tilt_deg=3.0)
    within = np.array([2e-3, -1e-3, -7e-3])
    found = [body(world, cell, "block") for cell in CELLS]
    world.place(CELLS, np.array([at + turn @ within for at, turn in found]), world.hole_yaw)
    pegs = [body(world, cell, "peg")[0] for cell in CELLS]
    expected = np.array([turn.T @ (peg - at) for peg, (at, turn) in zip(pegs, found, strict=True)])
    assert world.depth == pytest.approx(-expected[:, 2], abs=1e-12)
    assert world.offset == pytest.approx(expected[:, :2], abs=1e-12)
    assert world.depth == pytest.approx(np.full(N, 7e-3), abs=1e-4)


def test_a_moved_hole_stays_tilted() -> None:
    world = worlds(hole_tilt_deg=1.0)
    world.move_hole(CELLS, world.hole_position + 1e-3, np.full(N, 0.4))
    world.place(CELLS, world.hole_position + 0.03 * UP, np.zeros(N))
    turns = np.array([body(world, cell, "block")[1] for cell in CELLS])
    assert degrees(turns[:, :, 2], UP) == pytest.approx(np.full(N, 1.0))
    assert world.hole_yaw == pytest.approx(np.full(N, 0.4))


def test_a_wrong_calibration_puts_the_peg_beside_and_askew_of_the_measured_tcp() -> None:
    world, right = worlds(tcp_shift_m=1e-3, tcp_height_m=0.5e-3, tcp_tilt_deg=0.5), worlds()

    def off(world: World, cell: int) -> FloatArray:
        peg = body(world, cell, "peg")[0]
        return world.rotation[cell].T @ (peg - world.position[cell]) - [*draw(Task(cell)).grasp_offset, 0.0]

    shift = np.array([off(world, cell) for cell in CELLS])
    assert np.array([off(right, cell) for cell in CELLS]) == pytest.approx(np.zeros((N, 3)), abs=2e-6)
    assert np.linalg.norm(shift[:, :2], axis=1) == pytest.approx(np.full(N, 1e-3), abs=2e-6)
    assert np.abs(shift[:, 2]) == pytest.approx(np.full(N, 0.5e-3), abs=2e-6)
    axes = np.array([body(world, cell, "peg")[1][:, 2] for cell in CELLS])
    assert degrees(axes, world.rotation[:, :, 2]) == pytest.approx(np.full(N, 0.5), abs=1e-3)
    assert world.position == pytest.approx(right.position, abs=1e-6)  # the arm knows nothing of it


def test_a_gain_scales_every_load_and_the_zero_takes_it_away_at_rest() -> None:
    world = worlds(ft_gain_error=0.1)
    world.zero_ft(CELLS)
    raw, wrench = readings(world)
    assert np.abs(raw[:, 2] / WEIGHT_N - 1.0) == pytest.approx(np.full(N, 0.1), abs=1e-3)
    assert np.linalg.norm(wrench[:, :3], axis=1).max() < 0.25


def test_a_touch_is_read_with_the_gain() -> None:
    pressed = [worlds(**errors) for errors in ({}, {"ft_gain_error": 0.2})]
    read = []
    for world in pressed:
        world.zero_ft(CELLS)
        place = world.hole_position + PRESSED
        world.place(CELLS, place, world.hole_yaw)
        read.append(readings(world)[1][:, 2])
    assert (read[0] > 5.0).all()
    assert np.abs(read[1] / read[0] - 1.0) == pytest.approx(np.full(N, 0.2), abs=0.03)


def test_turned_axes_turn_the_force_that_is_read_and_not_its_size() -> None:
    world = worlds(ft_turn_deg=10.0)
    world.zero_ft(CELLS)
    raw, wrench = readings(world)
    turns = [pose.rotation_from_rotvec(draw(task).errors.ft_turn) for task in tasks(ft_turn_deg=10.0)]
    assert raw[:, :3] == pytest.approx(np.array([turn.T @ [0.0, 0.0, WEIGHT_N] for turn in turns]), abs=0.02)
    assert np.linalg.norm(raw[:, :3], axis=1) == pytest.approx(np.full(N, WEIGHT_N), abs=0.02)
    assert np.linalg.norm(wrench[:, :3], axis=1).max() < 0.25


def test_what_a_zero_leaves_is_read_in_free_air_and_turns_with_the_tool() -> None:
    world = worlds(ft_left_n=2.0)
    world.zero_ft(CELLS)
    first = readings(world)[1]
    assert np.linalg.norm(first[:, :3], axis=1) == pytest.approx(np.full(N, 2.0), abs=0.25)
    lever = np.cross([0.0, 0.0, scene.TCP_OFFSET_M], [draw(task).errors.ft_left[:3] for task in tasks(ft_left_n=2.0)])
    assert np.linalg.norm(first[:, 3:], axis=1) == pytest.approx(np.linalg.norm(lever, axis=1), abs=0.06)
    torque = worlds(ft_left_nm=0.15)
    torque.zero_ft(CELLS)
    assert np.linalg.norm(readings(torque)[1][:, 3:], axis=1) == pytest.approx(np.full(N, 0.15), abs=0.06)


def test_a_payload_that_is_heavier_and_off_its_centre_is_read_and_zeroed() -> None:
    world = worlds(payload_mass_scale=1.2, payload_shift_m=0.02)
    world.zero_ft(CELLS)
    raw, wrench = readings(world)
    assert raw[:, 2] == pytest.approx(np.full(N, 1.2 * WEIGHT_N), abs=0.02)
    assert np.linalg.norm(raw[:, 3:5], axis=1) == pytest.approx(np.full(N, 1.2 * WEIGHT_N * 0.02), abs=2e-3)
    assert np.linalg.norm(wrench[:, :3], axis=1).max() < 0.25
    assert np.linalg.norm(wrench[:, 3:], axis=1).max() < 0.06


def test_softer_joints_give_more_under_the_same_weight() -> None:
    stiff, soft = worlds(), worlds(joint_stiffness_scale=0.5)
    for world in (stiff, soft):
        readings(world)
    give = [world._ctrl - world.joints for world in (stiff, soft)]
    assert give[1][:, 1:3] == pytest.approx(2.0 * give[0][:, 1:3], rel=0.05)


def test_softer_joints_keep_their_damping_ratio() -> None:
    stiff, soft = worlds(1).model(), worlds(1, joint_stiffness_scale=0.25).model()
    ratios = [-model.actuator_biasprm[:, 2] / np.sqrt(model.actuator_gainprm[:, 0]) for model in (stiff, soft)]
    assert ratios[1] == pytest.approx(ratios[0])
    assert (soft.actuator_biasprm[:, 1] == -soft.actuator_gainprm[:, 0]).all()


def test_a_joint_with_friction_stays_until_it_is_pushed_harder() -> None:
    free, rubbing = worlds(1), worlds(1, joint_friction_share=0.1)
    moved = []
    for world in (free, rubbing):
        readings(world, 100)
        begin, set_points = world.joints, world._ctrl.copy()
        set_points[:, 0] += 1e-3  # 3.5 of 5.4 N·m
        for _ in range(200):
            world.drive(set_points)
        moved.append(world.joints[0, 0] - begin[0, 0])
    assert moved[0] == pytest.approx(1e-3, abs=2e-5)
    assert moved[1] < 2e-4


def test_a_gear_with_backlash_lets_a_drive_turn_before_its_link_follows() -> None:
    world = worlds(1, joint_backlash_deg=0.2)
    half = np.deg2rad(0.1)
    readings(world, 100)
    begin, drive, moved = world.joints[0, 0], world.joints, []
    for turn in (half / 2, 3 * half, 1.5 * half, -half):
        aim = drive.copy()
        aim[:, 0] += turn
        for _ in range(300):
            world.drive(aim)
        moved.append((world.joints[0, 0] - begin) / half)
    assert moved == pytest.approx([0.0, 2.0, 2.0, 0.0], abs=0.02)


def test_a_placed_arm_stands_in_the_middle_of_its_play() -> None:
    world = worlds(1, joint_backlash_deg=0.2)
    world.place(CELLS[:1], world.hole_position + 0.05 * UP, np.full(1, 0.5))
    begin = world.joints
    world.tick()  # the set-point that carries the payload lies within the play
    assert world._ctrl == pytest.approx(begin, abs=1e-9)


def test_a_gear_with_ripple_is_off_by_a_wave_of_its_angle() -> None:
    even, uneven = worlds(1), worlds(1, joint_ripple_deg=0.05)
    readings(even, 100)
    off = []
    for wave in np.linspace(0.0, 2.0, 17):
        aim = even.joints
        aim[0, 0] = wave * 2.0 * np.pi / 202
        for world in (even, uneven):
            world.place(CELLS[:1], world.position, np.zeros(1))
            for _ in range(300):
                world.drive(aim)
        off.append(uneven.joints[0, 0] - even.joints[0, 0])
    wanted = np.deg2rad(0.05) * np.sin(2.0 * np.pi * np.linspace(0.0, 2.0, 17))
    assert off == pytest.approx(wanted, abs=np.deg2rad(0.002))


def test_softer_fingers_let_the_peg_tilt_further() -> None:
    angles = []
    for errors in ({}, {"finger_stiffness_scale": 0.5}):
        world = worlds(1, **errors)
        model, data = world.model(), world.data()
        data.ctrl[:] = world._ctrl[0]
        finger = model.joint("finger").dofadr[0]
        before = data.qpos[finger]
        data.qfrc_applied[finger] = 0.1
        mujoco.mj_step(model, data, 200)
        angles.append(data.qpos[finger] - before)
    assert angles[1] == pytest.approx(2.0 * angles[0], rel=0.05)


def test_a_stiffer_contact_gives_less_under_the_same_force() -> None:
    give = []
    for errors in ({}, {"contact_time_scale": 0.5}):
        world = worlds(**errors)
        world.place(CELLS, world.hole_position + PRESSED, world.hole_yaw)
        for _ in range(300):
            world.tick()
        give.append(world.depth / world.contact_force[:, 2])
    assert give[1] == pytest.approx(0.25 * give[0], rel=0.2)


def test_the_camera_is_off_as_told() -> None:
    exact = worlds(camera_error_scale=0.0)
    assert exact.estimate == pytest.approx(exact.hole_position, abs=1e-3)  # its jitter stays
    off = worlds(camera_error_scale=0.0, camera_bias_m=3e-3, camera_height_m=1e-3).estimate - exact.estimate
    assert np.linalg.norm(off[:, :2], axis=1) == pytest.approx(np.full(N, 3e-3))
    assert np.abs(off[:, 2]) == pytest.approx(np.full(N, 1e-3))
    wider, usual = (draw(Task(3, plant=errors)) for errors in (PlantErrors(camera_error_scale=2.0), None))
    assert wider.estimate_offset == pytest.approx(2.0 * usual.estimate_offset)


def test_noise_drift_and_delay_of_the_sensor_and_friction_are_as_told() -> None:
    errors = PlantErrors(ft_noise_scale=2.0, ft_drift_scale=10.0, ft_delay_ticks=20, friction_added=0.3)
    one, usual = draw(Task(3, plant=errors)), draw(Task(3))
    assert np.array_equal(one.wrench_noise, 2 * usual.wrench_noise)
    assert one.drift == pytest.approx(10.0 * usual.drift)
    assert one.sensor_delay == usual.sensor_delay + 20
    world = worlds(friction_added=0.3)
    assert world.friction == pytest.approx(np.full(N, 0.6))


def test_a_late_sensor_shows_a_touch_later() -> None:
    seen = []
    for late in (0, 20):
        world = worlds(1, ft_noise_scale=0.0, ft_delay_ticks=late)
        readings(world, 100)
        before = world.sensor.raw[0, 2]
        world.place(CELLS[:1], world.hole_position + PRESSED, world.hole_yaw)
        ticks = 0
        while abs(world.sensor.raw[0, 2] - before) < 3.0:
            world.tick()
            ticks += 1
        seen.append(ticks)
    assert seen[1] - seen[0] == 20


def test_a_target_takes_effect_late_by_a_delay_that_varies() -> None:
    world = worlds(1, target_delay_ticks=10, target_jitter_ticks=5)
    only = CELLS[:1]
    law = np.full(6, 1000.0), np.full(6, 300.0), np.full(6, 2.0)
    world.engage(only, *law, FREE)
    taken = []
    for number in range(JITTERS):
        target = world.arm.target_position + 1e-4 * (-1) ** number * UP
        assert world.arm.set_target(only, target, world.arm.target_quaternion.copy())[0]
        ticks = 0
        while not (world.arm.target_position == target).all():
            world.tick()
            ticks += 1
        taken.append(ticks - 1)
    assert set(taken) == set(range(12, 18))


def test_errors_of_a_plant_leave_every_other_draw_of_the_seed_as_it_is() -> None:
    usual = draw(Task(5))
    one = draw(Task(5, plant=PlantErrors(hole_tilt_deg=1.0, tcp_shift_m=1e-3, ft_left_n=1.0, target_jitter_ticks=4)))
    for field in dataclasses.fields(usual):
        if field.name != "errors":
            assert np.array_equal(getattr(usual, field.name), getattr(one, field.name)), field.name


def test_seeds_share_out_the_plants_if_their_number_is_given() -> None:
    shared = [draw(task).errors.hole_tilt.tobytes() for task in tasks(12, plants=4, hole_tilt_deg=1.0)]
    assert shared[:4] * 3 == shared
    assert len(set(shared)) == 4


def test_signs_and_directions_are_as_often_one_way_as_the_other() -> None:
    directions = np.array([draw(task).errors.hole_tilt[:2] for task in tasks(400, hole_tilt_deg=1.0)])
    assert np.linalg.norm(directions.mean(0)) < 0.15 * np.deg2rad(1.0)


def test_a_cell_whose_plant_had_errors_is_as_new_without_them() -> None:
    fresh, used = World(2), World(2)
    both = np.arange(2)
    used.reset(both, [dataclasses.replace(task, plant=EVERY) for task in tasks(2)])
    for _ in range(20):
        used.tick()
    for world in (fresh, used):
        world.reset(both, [Task(11), Task(12)])
        world.zero_ft(both)
        for _ in range(50):
            world.tick()
    assert_equal(told(fresh), told(used), "the end")
    one, other = fresh.model(1), used.model(1)
    for name in ("geom_friction", "geom_solref", "geom_pos", "body_pos", "body_quat", "body_ipos", "body_mass"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name
    for name in ("site_quat", "jnt_stiffness", "dof_frictionloss", "actuator_gainprm", "actuator_biasprm"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name


def test_every_error_changes_the_world() -> None:
    assert {field.name for field in dataclasses.fields(PlantErrors)} - {"plants"} == {
        *EVERY.to_json(),
        *ODD_PEG.to_json(),
    }


@pytest.mark.parametrize(
    ("document", "text"),
    [
        ({"hole_tilt": 1.0}, r"plant\.hole_tilt is no error of a plant; there are plants, friction_added, "),
        ({"hole_tilt_deg": 5.1}, r"plant\.hole_tilt_deg must be a number from 0 to 5, not 5\.1"),
        ({"hole_tilt_deg": float("nan")}, r"plant\.hole_tilt_deg must be a number from 0 to 5, not nan"),
        ({"ft_left_n": True}, r"plant\.ft_left_n must be a number from 0 to 5, not True"),
        ({"ft_delay_ticks": 1.0}, r"plant\.ft_delay_ticks must be an integer from 0 to 20, not 1\.0"),
        ({"plants": -1}, r"plant\.plants must be an integer from 0 to 1000, not -1"),
        ([], r"plant must be an object of errors, not \[\]"),
    ],
)
def test_what_no_plant_can_have_is_refused(document: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Task.from_json({"seed": 0, "plant": document})


def test_a_task_with_a_plant_is_the_same_after_its_way_as_json() -> None:
    task = Task(3, plant=PlantErrors(hole_tilt_deg=1, ft_delay_ticks=3))
    assert task.to_json()["plant"] == {"hole_tilt_deg": 1, "ft_delay_ticks": 3}
    assert Task.from_json(task.to_json()) == task
