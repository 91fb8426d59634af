"""Appearance of the cell: shapes, materials, lights and cameras for pictures; the physics uses none of them.

A dressed scene has the bodies and joints of the plain one, so one simulation state fits both. The shapes follow the
silhouette of the UR3e and of a two-finger gripper. Link offsets along the joints are UR's, derived from the centres of
mass.
"""

import math
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from sim_backend.world import scene
from sim_backend.world.parts import HOLE_DEPTH_M, PARTS, Part, hole_walls
from wire.arrays import FloatArray

CAMERAS = ("overview", "side", "hole", "wrist")

_HIDDEN_GROUP = 3
"""Group that MuJoCo does not draw; it draws groups 0 to 2 by default."""
_UNTOUCHED: dict[str, Any] = {"contype": 0, "conaffinity": 0, "group": 1, "mass": 0}
_BLOCK_HALF_WIDTH_M = 0.075
_TABLE_THICKNESS_M = 0.04
_FLOOR_Z_M = -0.72
_PLATE_HALF_SIZE_M = (0.024, 0.060)
_MODULE_PIXELS = 16
"""Texture pixels along a marker's module; filtering would blur a single one."""
_MATERIALS = {
    #        colour, specular, shininess, reflectance
    "shell": ((0.78, 0.80, 0.82), 0.45, 0.55, 0.0),
    "joint": ((0.36, 0.38, 0.41), 0.35, 0.45, 0.0),
    "cap": ((0.36, 0.61, 0.78), 0.40, 0.60, 0.0),
    "rubber": ((0.13, 0.14, 0.15), 0.20, 0.30, 0.0),
    "aluminium": ((0.66, 0.69, 0.73), 0.55, 0.50, 0.0),
    "steel": ((0.36, 0.39, 0.43), 0.45, 0.45, 0.0),
    "table": ((0.78, 0.74, 0.67), 0.10, 0.20, 0.0),
    "leg": ((0.30, 0.31, 0.33), 0.20, 0.30, 0.0),
    "peg": ((0.93, 0.47, 0.10), 0.35, 0.45, 0.0),
}
_MARKERS = ((181, 50), (15, 154))
"""Bits of two 4 x 4 markers, row by row from the top left; 1 is white. Numbers 0 and 1 of ArUco's 4x4 dictionaries."""


def dress(spec: mujoco.MjSpec, part_name: str, clearance_m: float) -> None:
    """Add everything visual to a plain scene, and hide its collision shapes except the peg's.

    Args:
        spec: specification from `scene.specify`, with the same part and clearance.
        part_name: name of the peg and its hole.
        clearance_m: clearance per face, m.
    """
    part = PARTS[part_name]
    for name, (colour, specular, shininess, reflectance) in _MATERIALS.items():
        spec.add_material(name=name, rgba=[*colour, 1], specular=specular, shininess=shininess, reflectance=reflectance)
    for geom in spec.geoms:
        geom.group = _HIDDEN_GROUP
    peg = spec.geom("peg")
    peg.group, peg.material, peg.rgba = 0, "peg", [0.5, 0.5, 0.5, 1]  # MuJoCo's default lets the material show
    _add_room(spec)
    _add_block(spec, part, clearance_m)
    _add_arm(spec)
    _add_gripper(spec, part)
    _add_cameras(spec)


def _add_room(spec: mujoco.MjSpec) -> None:
    visual = spec.visual
    visual.headlight.ambient = [0.34, 0.34, 0.36]
    visual.headlight.diffuse = [0.22, 0.22, 0.22]
    visual.headlight.specular = [0.05, 0.05, 0.05]
    visual.quality.shadowsize = 4096
    visual.quality.offsamples = 8
    visual.map.znear = 0.01
    visual.map.shadowclip = 1.2
    spec.stat.extent = 1.0
    spec.stat.center = [0.2, 0.0, 0.1]
    spec.add_texture(
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.93, 0.94, 0.95], rgb2=[0.62, 0.66, 0.70], width=256, height=256,
    )  # fmt: skip
    spec.add_texture(
        name="tiles", type=mujoco.mjtTexture.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.58, 0.60, 0.62], rgb2=[0.55, 0.57, 0.59], width=256, height=256,
    )  # fmt: skip
    floor = spec.add_material(name="floor", specular=0.05, shininess=0.1, texrepeat=[3, 3], texuniform=True)
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    world = spec.worldbody
    world.add_light(
        pos=[0.9, -0.9, 1.7], dir=[-0.40, 0.45, -1.0], type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        diffuse=[0.58, 0.57, 0.55], specular=[0.25, 0.25, 0.25], castshadow=True,
    )  # fmt: skip
    world.add_light(
        pos=[-0.8, -0.6, 1.2], dir=[0.6, 0.5, -0.8], type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        diffuse=[0.16, 0.17, 0.20], specular=[0.05, 0.05, 0.05], castshadow=False,
    )  # fmt: skip
    world.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, pos=[0, 0, _FLOOR_Z_M], size=[6, 6, 0.1], material="floor", **_UNTOUCHED
    )
    middle, half = spec.geom("table").pos, spec.geom("table").size
    _box(world, middle, half, "table")
    for x in (-1, 1):
        for y in (-1, 1):
            leg = [middle[0] + x * (half[0] - 0.04), middle[1] + y * (half[1] - 0.04)]
            height = 0.5 * (-_TABLE_THICKNESS_M - _FLOOR_Z_M)
            _box(world, [*leg, _FLOOR_Z_M + height], [0.025, 0.025, height], "leg")


def _add_block(spec: mujoco.MjSpec, part: Part, clearance_m: float) -> None:
    """Add a block, a base, a post and markers; the block's hole has the outline of the collision walls, one convex
    wedge per wall.
    """
    block = spec.body("block")
    for index, wedge in enumerate(_wedges(part, clearance_m)):
        vertices = [np.column_stack([wedge, np.full(len(wedge), z)]) for z in (0.0, -HOLE_DEPTH_M)]
        spec.add_mesh(name=f"wedge{index}", uservert=np.concatenate(vertices).ravel())
        block.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"wedge{index}", material="aluminium", **_UNTOUCHED)
    half, depth = _BLOCK_HALF_WIDTH_M, HOLE_DEPTH_M
    _box(block, [0, 0, -depth - 0.008], [half, half, 0.008], "joint")
    _cylinder(block, [0, 0, -depth - 0.016], [0, 0, -0.112], 0.030, "joint")
    plate = -half - _PLATE_HALF_SIZE_M[0] - 0.004
    _box(block, [plate, 0, -0.004], [*_PLATE_HALF_SIZE_M, 0.003], "shell")
    _box(block, [-half, 0, -depth - 0.004], [0.040, 0.012, 0.004], "steel")
    _box(block, [plate, 0, -0.5 * depth - 0.004], [0.008, 0.012, 0.5 * depth - 0.002], "steel")
    for index, bits in enumerate(_MARKERS):
        spec.add_texture(
            name=f"marker{index}",
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            width=8 * _MODULE_PIXELS,
            height=8 * _MODULE_PIXELS,
            nchannel=3,
            data=_marker(bits).ravel().tolist(),
        )
        paper = spec.add_material(name=f"marker{index}", specular=0.05, shininess=0.1)
        paper.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = f"marker{index}"
        _box(block, [plate, (2 * index - 1) * 0.028, 0], [0.020, 0.020, 0.0012], f"marker{index}")


def _wedges(part: Part, clearance_m: float) -> list[FloatArray]:
    """Cut a square with the hole in it into convex polygons, (k, 2) m: one between each wall and the square's edge."""
    walls = hole_walls(part, clearance_m)
    walls = walls[np.argsort(walls[:, 0])]
    normals = np.stack([np.cos(walls[:, 0]), np.sin(walls[:, 0])], axis=1)
    corners: list[FloatArray] = [  # corner i lies between the walls i - 1 and i
        np.asarray(np.linalg.solve(normals[[i, i - 1]], walls[[i, i - 1], 1]), np.float64) for i in range(len(walls))
    ]
    square = _BLOCK_HALF_WIDTH_M * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    wedges: list[FloatArray] = []
    for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
        spread = _angle(end) - _angle(start)
        between = [corner for corner in square if 0 < (_angle(corner) - _angle(start)) % math.tau < spread % math.tau]
        outer = [_BLOCK_HALF_WIDTH_M * point / np.abs(point).max() for point in (start, end)]
        wedges.append(np.array([start, end, *outer, *between]))
    return wedges


def _angle(point: FloatArray) -> float:
    return math.atan2(point[1], point[0])


def _marker(bits: tuple[int, int]) -> npt.NDArray[np.uint8]:
    """Return (8 k, 8 k, 3) uint8: sixteen bits in a black frame on white paper."""
    picture = np.full((8, 8), 250, np.uint8)
    picture[1:7, 1:7] = 15
    picture[2:6, 2:6] = np.where(np.unpackbits(np.array(bits, np.uint8)).reshape(4, 4), 250, 15)
    magnified = picture.repeat(_MODULE_PIXELS, axis=0).repeat(_MODULE_PIXELS, axis=1)
    return np.repeat(magnified[:, :, None], 3, axis=2)


def _add_arm(spec: mujoco.MjSpec) -> None:
    """Add housings along each joint's axis and tubes between them, in the frames of the links."""
    shoulder_z, upper_x, fore_x = 0.15185, -0.24355, -0.2132
    upper_z, fore_z, wrist_1_z, wrist_2_z, flange_z = 0.120, 0.027, 0.13105, 0.08535, 0.0921
    base = spec.worldbody
    _cylinder(base, [0, 0, 0], [0, 0, 0.012], 0.075, "joint")
    _cylinder(base, [0, 0, 0.012], [0, 0, 0.086], 0.064, "shell")

    link = spec.body("link1")
    _cylinder(link, [0, 0, 0.088], [0, 0, shoulder_z + 0.02], 0.060, "joint")
    _sphere(link, [0, 0, shoulder_z + 0.012], 0.060, "joint")
    _cylinder(link, [0, 0.0, shoulder_z], [0, -0.062, shoulder_z], 0.058, "joint")

    link = spec.body("link2")
    _housing(link, [0, 0, upper_z], 0.055, 0.057)
    _cylinder(link, [0, 0, upper_z], [upper_x, 0, upper_z], 0.042, "shell")
    _housing(link, [upper_x, 0, upper_z], 0.046, 0.048)

    link = spec.body("link3")
    _housing(link, [0, 0, fore_z], 0.043, 0.044, flip=True)
    _cylinder(link, [0, 0, fore_z], [fore_x, 0, fore_z], 0.034, "shell")
    _housing(link, [fore_x, 0, fore_z], 0.036, 0.038, flip=True)

    link = spec.body("link4")
    _cylinder(link, [0, 0, fore_z + 0.038], [0, 0, wrist_1_z], 0.032, "joint")
    _sphere(link, [0, 0, wrist_1_z], 0.0335, "joint")
    _cylinder(link, [0, 0.036, wrist_1_z], [0, -0.042, wrist_1_z], 0.0335, "joint")
    _disc(link, [0, 0.037, wrist_1_z], [0, 1, 0], 0.030, "cap")
    _disc(link, [0, 0, wrist_1_z + 0.034], [0, 0, 1], 0.022, "cap")

    link = spec.body("link5")
    _cylinder(link, [0, 0, 0.043], [0, 0, wrist_2_z], 0.0325, "shell")
    _cylinder(link, [0, -0.036, wrist_2_z], [0, 0.046, wrist_2_z], 0.0335, "joint")
    _disc(link, [0, -0.037, wrist_2_z], [0, -1, 0], 0.030, "cap")
    _cylinder(link, [0, 0, wrist_2_z], [0, 0, wrist_2_z + 0.034], 0.031, "joint")

    _cylinder(spec.body("link6"), [0, 0, 0.047], [0, 0, flange_z], 0.0325, "shell")


def _housing(link: Any, centre: list[float], radius: float, half_length: float, *, flip: bool = False) -> None:
    """Add a joint's housing about its z axis, with a cap on the side away from the next link."""
    x, y, z = centre
    _cylinder(link, [x, y, z - half_length], [x, y, z + half_length], radius, "joint")
    end = -1 if flip else 1
    _disc(link, [x, y, z + end * (half_length + 0.001)], [0, 0, end], 0.86 * radius, "cap")


def _add_gripper(spec: mujoco.MjSpec, part: Part) -> None:
    """Add a round body, two fingers of two links each, and pads that touch the peg's sides."""
    gripper = spec.body("gripper")
    _cylinder(gripper, [0, 0, 0], [0, 0, 0.012], 0.0375, "aluminium")
    _cylinder(gripper, [0, 0, 0.012], [0, 0, 0.060], 0.0375, "rubber")
    _box(gripper, [0, 0, 0.072], [0.020, 0.044, 0.014], "rubber")
    for side, reach in ((1, part.outline[:, 1].max()), (-1, -part.outline[:, 1].min())):
        pad = side * (float(reach) + 0.003)
        knuckle = side * max(0.036, abs(pad) + 0.012)
        _cylinder(gripper, [-0.014, knuckle, 0.078], [0.014, knuckle, 0.078], 0.010, "aluminium")
        _capsule(gripper, [0, knuckle, 0.080], [0, knuckle + side * 0.008, 0.108], 0.008, "rubber")
        _capsule(gripper, [0, knuckle + side * 0.008, 0.108], [0, pad + side * 0.009, 0.128], 0.008, "rubber")
        _box(gripper, [0, pad + side * 0.006, 0.133], [0.012, 0.005, 0.017], "aluminium")
        _box(gripper, [0, pad, 0.133], [0.011, 0.003, 0.017], "rubber")


def _add_cameras(spec: mujoco.MjSpec) -> None:
    hole = np.array(scene.NOMINAL_HOLE_M)
    up = np.array([0.0, 0.0, 1.0])
    for name, eye, target, fovy in (
        ("overview", np.array([0.90, -0.74, 0.50]), np.array([0.15, -0.07, 0.205]), 38),
        ("side", np.add(hole, [0.03, -0.52, 0.14]), np.add(hole, [0.0, 0.0, 0.075]), 36),
        ("hole", np.add(hole, [0.17, -0.20, 0.20]), np.add(hole, [0.0, 0.0, 0.035]), 42),
    ):
        spec.worldbody.add_camera(name=name, pos=eye, quat=_looking(eye, target, up), fovy=fovy)
    eye, tip = np.array([0.085, 0.0, 0.035]), np.array([0.0, 0.0, scene.TCP_OFFSET_M + 0.03])
    spec.body("gripper").add_camera(name="wrist", pos=eye, quat=_looking(eye, tip, np.array([1.0, 0, 0])), fovy=58)


def _looking(eye: FloatArray, target: FloatArray, up: FloatArray) -> FloatArray:
    """Return the quaternion (w, x, y, z) of a camera at `eye`: -z axis towards `target`, y axis towards `up`."""
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.stack([right, np.cross(back, right), back], axis=1).ravel())
    return quat


def _box(body: Any, centre: Any, half: Any, material: str) -> None:
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=list(centre), size=list(half), material=material, **_UNTOUCHED)


def _cylinder(body: Any, start: list[float], end: list[float], radius: float, material: str) -> None:
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER, fromto=[*start, *end], size=[radius, 0, 0], material=material, **_UNTOUCHED
    )


def _capsule(body: Any, start: list[float], end: list[float], radius: float, material: str) -> None:
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[*start, *end], size=[radius, 0, 0], material=material, **_UNTOUCHED
    )


def _sphere(body: Any, centre: list[float], radius: float, material: str) -> None:
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=centre, size=[radius, 0, 0], material=material, **_UNTOUCHED)


def _disc(body: Any, centre: list[float], normal: list[float], radius: float, material: str) -> None:
    """Add a flat cap, 4 mm thick, centred at `centre`."""
    half = 0.002 * np.array(normal)
    _cylinder(body, list(np.array(centre) - half), list(np.array(centre) + half), radius, material)
