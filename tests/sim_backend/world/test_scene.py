"""The compiled scene against the geometry of `parts` and the arm of `kinematics`, by MuJoCo's own reckoning."""

import mujoco
import numpy as np
import pytest

from sim_backend.world import kinematics, scene
from sim_backend.world.parts import HOLE_DEPTH_M, PARTS, hole_walls, wall_centres, yaw_tolerance
from wire import pose

NEAR = np.array([-0.2, -1.9, -1.7, -1.1, 1.57, 0.0])
HOLE = np.array(scene.NOMINAL_HOLE_M)
CLEARANCES = [0.1e-3, 1e-3 / 3, 2e-3]
each_part = pytest.mark.parametrize("part", PARTS)


@pytest.fixture(scope="module")
def scenes():
    built: dict[tuple[str, float], tuple[scene.Scene, mujoco.MjData]] = {}

    def get(part, clearance=2e-3):
        if (part, clearance) not in built:
            made = scene.build(part, clearance)
            built[part, clearance] = made, mujoco.MjData(made.model)
        return built[part, clearance]

    return get


def joints_for(position, yaw=0.0):
    rotation = pose.tool_down(yaw)
    return kinematics.inverse(position - rotation @ [0, 0, scene.TCP_OFFSET_M], rotation, NEAR)


def pose_peg(made, data, position, yaw=0.0, finger=0.0):
    """Put the peg's tip at `position` without any dynamics; returns its contacts as {geom name: smallest distance}."""
    data.qpos[:] = [*joints_for(np.asarray(position), yaw), finger]
    mujoco.mj_forward(made.model, data)
    touched: dict[str, float] = {}
    for contact in data.contact[: data.ncon]:
        names = {made.model.geom(int(g)).name for g in contact.geom}
        assert "peg" in names
        (other,) = names - {"peg"}
        touched[other] = min(touched.get(other, 1.0), float(contact.dist))
    return touched


def test_the_arm_is_the_arm_of_the_kinematics(scenes):
    made, data = scenes("tr")
    rng = np.random.default_rng(0)
    site = made.model.site("tcp").id
    for _ in range(200):
        q = rng.uniform(-np.pi, np.pi, 6)
        data.qpos[:6], data.qpos[6] = q, 0.0
        mujoco.mj_kinematics(made.model, data)
        flange, rotation = kinematics.forward(q)
        assert data.site_xpos[site] == pytest.approx(flange + rotation @ [0, 0, scene.TCP_OFFSET_M], abs=1e-12)
        assert data.site_xmat[site].reshape(3, 3) == pytest.approx(rotation, abs=1e-12)


def test_joints_turn_the_way_the_jacobian_says(scenes):
    made, data = scenes("tr")
    q = np.array([-0.3, -1.8, -1.6, -1.2, 1.5, 0.4])
    data.qpos[:] = [*q, 0.0]
    mujoco.mj_forward(made.model, data)
    linear, angular = np.zeros((3, made.model.nv)), np.zeros((3, made.model.nv))
    mujoco.mj_jacSite(made.model, data, linear, angular, made.model.site("tcp").id)
    expected = kinematics.jacobian(q, [0, 0, scene.TCP_OFFSET_M])
    assert np.concatenate([linear, angular])[:, :6] == pytest.approx(expected, abs=1e-12)


def test_masses_and_centres_are_those_of_the_data_sheet(scenes):
    made, data = scenes("tr")
    model = made.model
    arm = sum(joint.mass_kg for joint in kinematics.UR3E)
    standing = model.body("block").mass[0]  # fixed to the world: its mass does nothing
    assert model.body_mass.sum() - standing == pytest.approx(arm + scene.PAYLOAD_KG, abs=1e-12)
    assert pytest.approx(0.93) == scene.PAYLOAD_KG
    assert scene.PAYLOAD_KG < kinematics.RATED_PAYLOAD_KG
    q = np.array([0.3, -1.2, 0.9, -0.7, 1.1, 0.2])
    data.qpos[:] = [*q, 0.0]
    mujoco.mj_forward(model, data)
    for i, joint in enumerate(kinematics.UR3E):
        assert model.body(f"link{i + 1}").mass[0] == joint.mass_kg
        # frame i's pose by the chain of the published transforms
        frame = np.eye(4)
        for angle, link in zip(q[: i + 1], kinematics.UR3E[: i + 1], strict=True):
            c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(link.alpha_rad), np.sin(link.alpha_rad)
            place = [link.a_m * c, link.a_m * s, link.d_m]
            turn = np.array([[c, -s * ca, s * sa], [s, c * ca, -c * sa], [0, sa, ca]])
            frame = frame @ np.vstack([np.column_stack([turn, place]), [0, 0, 0, 1]])
        centre = (frame @ [*joint.com_m, 1.0])[:3]
        assert data.xipos[model.body(f"link{i + 1}").id] == pytest.approx(centre, abs=1e-12)


def test_the_payload_that_the_controller_is_told_is_the_payload_that_hangs_there(scenes):
    made, data = scenes("cir")
    data.qpos[:] = [*joints_for(HOLE + np.array([0, 0, 0.1])), 0.0]
    mujoco.mj_forward(made.model, data)
    ids = [made.gripper_body, made.peg_body]
    centre = np.average(data.xipos[ids], axis=0, weights=made.model.body_mass[ids])
    flange = data.site_xpos[made.model.site("ft").id]
    assert flange[2] - centre[2] == pytest.approx(scene.PAYLOAD_COM_M, abs=1e-3)
    assert centre[:2] == pytest.approx(flange[:2], abs=1e-6)


def test_actuators_are_limited_to_the_joints_torques(scenes):
    model = scenes("tr")[0].model
    assert np.abs(model.actuator_forcerange[:, 0]).tolist() == [joint.torque_nm for joint in kinematics.UR3E]
    assert (model.actuator_forcerange[:, 1] == -model.actuator_forcerange[:, 0]).all()


def faces(model, geoms):
    """Angle and distance from the block's centre of the walls' inner faces, and height of their tops; block frame."""
    normal = np.zeros((len(geoms), 3))
    for row, geom in zip(normal, geoms, strict=True):
        mujoco.mju_rotVecQuat(row, np.array([1.0, 0, 0]), model.geom_quat[geom])
    centre, size = model.geom_pos[geoms], model.geom_size[geoms]
    return np.arctan2(normal[:, 1], normal[:, 0]), (centre * normal).sum(1) - size[:, 0], centre[:, 2] + size[:, 2]


@each_part
@pytest.mark.parametrize("clearance", CLEARANCES)
def test_every_wall_stands_where_the_part_says_and_the_tops_are_one_plane(scenes, part, clearance):
    made, _ = scenes(part, clearance)
    angle, distance, top = faces(made.model, made.wall_geoms)
    walls = hole_walls(PARTS[part], clearance)
    assert np.exp(1j * angle) == pytest.approx(np.exp(1j * walls[:, 0]), abs=1e-12)
    assert distance == pytest.approx(PARTS[part].wall_reach + clearance, abs=1e-12)
    assert top == pytest.approx(np.zeros(len(top)), abs=1e-15)
    assert (walls[:, 2] < scene.WALL_HALF_LENGTH_M).all()  # long enough to meet its neighbours
    floor = made.floor_geom
    assert made.model.geom_pos[floor, 2] + made.model.geom_size[floor, 2] == pytest.approx(-HOLE_DEPTH_M)
    assert 2 * scene.WALL_HALF_HEIGHT_M >= HOLE_DEPTH_M  # no gap between walls and floor


@each_part
def test_no_slab_reaches_into_the_hole_of_the_others(part):
    walls = hole_walls(PARTS[part], 6e-3)
    centres = wall_centres(PARTS[part], 6e-3, scene.WALL_HALF_THICKNESS_M)
    normal = np.stack([np.cos(walls[:, 0]), np.sin(walls[:, 0])], -1)
    # a slab lies beyond its own plane altogether, whatever its length
    inner = (centres * normal).sum(1) - scene.WALL_HALF_THICKNESS_M
    assert inner == pytest.approx(walls[:, 1], abs=1e-15)


@each_part
@pytest.mark.parametrize("clearance", CLEARANCES)
def test_a_centred_peg_at_the_same_yaw_hangs_free_in_its_hole(scenes, part, clearance):
    made, data = scenes(part, clearance)
    for yaw in (0.0, 0.7):
        data.mocap_quat[0] = [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
        assert pose_peg(made, data, HOLE - [0, 0, 0.012], yaw) == {}
    data.mocap_quat[0] = [1, 0, 0, 0]


@each_part
@pytest.mark.parametrize("clearance", CLEARANCES)
def test_a_displaced_peg_touches_the_wall_that_it_is_moved_onto_and_no_sooner(scenes, part, clearance):
    made, data = scenes(part, clearance)
    slack = 5e-6
    for i, normal in enumerate(PARTS[part].wall_normal):
        free = pose_peg(made, data, HOLE + np.array([*((clearance - slack) * normal), -0.012]))
        assert free == {}
        touched = pose_peg(made, data, HOLE + np.array([*((clearance + 2e-05) * normal), -0.012]))
        assert touched[f"wall{i}"] == pytest.approx(-20e-6, abs=slack)


@each_part
@pytest.mark.parametrize("clearance", CLEARANCES)
def test_a_turned_peg_is_free_up_to_the_yaw_tolerance_and_caught_beyond(scenes, part, clearance):
    made, data = scenes(part, clearance)
    tolerance = float(yaw_tolerance(PARTS[part], clearance))
    if tolerance >= np.pi:
        assert pose_peg(made, data, HOLE - [0, 0, 0.012], 0.5) == {}
        return
    for sign in (-1, 1):
        assert pose_peg(made, data, HOLE - [0, 0, 0.012], sign * (tolerance - 1e-3)) == {}
        assert pose_peg(made, data, HOLE - [0, 0, 0.012], sign * (tolerance + 2e-3))


@each_part
def test_a_turned_peg_stands_on_the_top_and_a_centred_one_on_the_floor(scenes, part):
    made, data = scenes(part, 1e-3 / 3)
    if part != "cir":
        assert min(pose_peg(made, data, HOLE - [0, 0, 50e-6], 0.5).values()) == pytest.approx(-50e-6, abs=2e-6)
    touched = pose_peg(made, data, HOLE - [0, 0, HOLE_DEPTH_M + 50e-6])
    assert set(touched) == {"floor"}
    assert touched["floor"] == pytest.approx(-50e-6, abs=2e-6)


def test_a_corner_of_the_triangle_lies_along_the_tools_x_axis(scenes):
    made, data = scenes("tr")
    pose_peg(made, data, HOLE + np.array([0, 0, 0.05]), 0.4)
    geom = made.peg_geom
    mesh = int(made.model.geom_dataid[geom])
    start, count = made.model.mesh_vertadr[mesh], made.model.mesh_vertnum[mesh]
    vertices = made.model.mesh_vert[start : start + count] @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
    bottom = vertices[vertices[:, 2] < HOLE[2] + 0.05 + 1e-6] - HOLE
    corners = np.sort(np.arctan2(bottom[:, 1], bottom[:, 0]))
    assert len(corners) == 3
    assert np.abs(np.exp(1j * corners) - np.exp(0.4j)).min() == pytest.approx(0.0, abs=1e-6)


def test_the_finger_tilts_the_peg_about_the_pads_and_not_further_than_its_range(scenes):
    made, data = scenes("tr")
    joint = made.model.joint("finger")
    assert np.rad2deg(joint.range) == pytest.approx([-3, 3])
    pose_peg(made, data, HOLE + np.array([0, 0, 0.05]), finger=0.0)
    upright = data.xpos[made.peg_body].copy()
    pose_peg(made, data, HOLE + np.array([0, 0, 0.05]), finger=0.05)
    moved = data.xpos[made.peg_body] - upright
    assert np.linalg.norm(moved) == pytest.approx(2 * (scene.PROTRUSION_M + 0.01) * np.sin(0.025), rel=1e-9)


def test_only_the_peg_touches_anything(scenes):
    model = scenes("tr")[0].model
    peg = scenes("tr")[0].peg_geom
    hitting = np.flatnonzero(model.geom_contype)
    assert hitting.tolist() == [peg]
    assert {model.geom(int(g)).name for g in np.flatnonzero(model.geom_conaffinity)} >= {"table", "floor", "wall0"}
