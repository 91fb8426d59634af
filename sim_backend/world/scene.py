"""The scene: a UR3e with a gripper and a peg above a block with a hole, built with MuJoCo's `MjSpec`.

`docs/reference/frames.md` defines the frames. The arm's bodies have its Denavit–Hartenberg frames, so MuJoCo's joint
angles are the controller's. The hole has one box slab per wall, each on the outer side of its face: the hole is exactly
the intersection of the inner half-spaces, at any clearance. Only the peg collides with the block, its floor and the
table.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from sim_backend.world.kinematics import GRAVITY_M_S2, UR3E
from sim_backend.world.parts import HOLE_DEPTH_M, PARTS, PEG_HEIGHT_M, Part, hole_walls, wall_centres
from sim_backend.world.peg import EXACT, PegShape, vertices
from wire.records import TICK_S

GRIPPER_LENGTH_M = 0.150
"""Distance from flange to fingertips of a Robotiq 2F-85 that is closed on the peg."""
PROTRUSION_M = 0.040
"""Distance from the fingertips to the peg's bottom."""
TCP_OFFSET_M = GRIPPER_LENGTH_M + PROTRUSION_M
GRIPPER_MASS_KG = 0.9
GRIPPER_COM_M = 0.055
PEG_MASS_KG = 0.03
PAYLOAD_KG = GRIPPER_MASS_KG + PEG_MASS_KG
PAYLOAD_COM_M = (GRIPPER_MASS_KG * GRIPPER_COM_M + PEG_MASS_KG * (TCP_OFFSET_M - PEG_HEIGHT_M / 2)) / PAYLOAD_KG

WALL_HALF_THICKNESS_M = 0.060
WALL_HALF_LENGTH_M = 0.110
WALL_HALF_HEIGHT_M = 0.014
NOMINAL_HOLE_M = (0.300, -0.110, 0.080)
"""Centre of the hole's mouth; the conditions scatter the hole about it."""

FINGER_RANGE_RAD = float(np.deg2rad(3.0))
FINGER_STIFFNESS_NM = 12.0
FINGER_DAMPING_NMS = 0.03

JOINT_STIFFNESS_NM = (3500.0, 3500.0, 3500.0, 800.0, 800.0, 800.0)
"""Stiffness of the joints' position loops with their transmissions, N·m/rad; about 1.7e4 N/m vertically at the TCP.
An assumption: UR publishes none."""
JOINT_ARMATURE_KGM2 = (0.12, 0.12, 0.12, 0.02, 0.02, 0.02)
"""Rotor inertia behind the gears. An assumption: UR publishes none."""
JOINT_DAMPING_RATIO = 1.0

CONTACT_TIME_S = 12e-3
"""Nominal time constant of contact; a simulation may have another. With a shorter one a jammed peg continues to vibrate
under a stopped arm; docs/reference/conditions.md gives figures."""
_CONTACT = {"solref": [CONTACT_TIME_S, 1.0], "solimp": [0.95, 0.99, 0.0005, 0.5, 2.0]}


@dataclass(frozen=True, slots=True)
class Scene:
    """A compiled scene and the indices that the world needs.

    Attributes:
        model: model compiled for `part`; clearance, hole pose and plant vary per simulation without a rebuild.
        part: the peg and its hole.
        wall_geoms: (k,) geom ids of the hole's walls, in the order of `wall_centres`.
        floor_geom: geom id of the hole's floor.
        peg_geom: collision geom of the peg.
        peg_body: body of the peg; its position contains the grasp offset.
        gripper_body: body that carries the sensor.
    """

    model: mujoco.MjModel
    part: Part
    wall_geoms: np.ndarray
    floor_geom: int
    peg_geom: int
    peg_body: int
    gripper_body: int


def build(part_name: str = "tr", clearance_m: float = 2.0e-3, shape: PegShape = EXACT) -> Scene:
    """Build and compile the scene without its visual parts, which `appearance` adds.

    Args:
        part_name: one of `parts.PARTS`.
        clearance_m: initial clearance per face of the walls, m.
        shape: errors of the peg's shape.

    Raises:
        KeyError: there is no such part.
    """
    part = PARTS[part_name]
    model = specify(part_name, clearance_m, shape).compile()
    return Scene(
        model=model,
        part=part,
        wall_geoms=np.array([model.geom(f"wall{i}").id for i in range(len(hole_walls(part, clearance_m)))]),
        floor_geom=model.geom("floor").id,
        peg_geom=model.geom("peg").id,
        peg_body=model.body("peg").id,
        gripper_body=model.body("gripper").id,
    )


def specify(part_name: str, clearance_m: float, shape: PegShape = EXACT) -> mujoco.MjSpec:
    """Return the specification that `build` compiles."""
    part = PARTS[part_name]
    spec = mujoco.MjSpec()
    spec.modelname = f"dsl-assembly-{part_name}"
    spec.compiler.degree = False
    spec.add_numeric(name="call", data=[0.0, 0.0], size=2)  # for `together`
    option = spec.option
    option.timestep = TICK_S
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    # walls move per simulation and then leave the bounding volumes of the compilation
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE
    option.gravity = [0, 0, -GRAVITY_M_S2]

    _add_surroundings(spec)
    _add_block(spec, part, clearance_m)
    flange = _add_arm(spec)
    _add_tool(spec, flange, part, shape)
    return spec


def _add_surroundings(spec: mujoco.MjSpec) -> None:
    spec.worldbody.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[0.25, 0.0, -0.02],
        size=[0.45, 0.40, 0.02],
        contype=0,
        conaffinity=1,
        **_CONTACT,
    )


def _add_block(spec: mujoco.MjSpec, part: Part, clearance_m: float) -> None:
    """Add the block as a mocap body: its pose is the hole's mouth (x, y, z, yaw) and is part of a
    simulation's state.
    """
    block = spec.worldbody.add_body(name="block", mocap=True, pos=list(NOMINAL_HOLE_M))
    walls = hole_walls(part, clearance_m)
    centres = wall_centres(part, clearance_m, WALL_HALF_THICKNESS_M)
    for i, (angle, centre) in enumerate(zip(walls[:, 0], centres, strict=True)):
        block.add_geom(
            name=f"wall{i}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[centre[0], centre[1], -WALL_HALF_HEIGHT_M],
            quat=[np.cos(angle / 2), 0, 0, np.sin(angle / 2)],
            size=[WALL_HALF_THICKNESS_M, WALL_HALF_LENGTH_M, WALL_HALF_HEIGHT_M],
            contype=0,
            conaffinity=1,
            **_CONTACT,
        )
    block.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[0, 0, -HOLE_DEPTH_M - 0.01],
        size=[0.04, 0.04, 0.01],
        contype=0,
        conaffinity=1,
        **_CONTACT,
    )


def _add_arm(spec: mujoco.MjSpec) -> "mujoco.MjsBody":
    """Add six links in their Denavit–Hartenberg frames; return the gripper's body, whose frame is the flange's."""
    parent = spec.worldbody.add_body(name="base")
    step_pos, step_quat = np.zeros(3), np.array([1.0, 0, 0, 0])
    for i, joint in enumerate(UR3E):
        link = parent.add_body(name=f"link{i + 1}", pos=step_pos, quat=step_quat, gravcomp=1)
        link.add_joint(
            name=f"joint{i + 1}",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=[0, 0, 1],
            armature=JOINT_ARMATURE_KGM2[i],
            limited=False,
        )
        # frame i after the whole transform; UR gives masses in that frame
        step_pos = np.array([joint.a_m, 0.0, joint.d_m])
        step_quat = np.array([np.cos(joint.alpha_rad / 2), np.sin(joint.alpha_rad / 2), 0, 0])
        centre = np.zeros(3)
        mujoco.mju_rotVecQuat(centre, np.asarray(joint.com_m, float), step_quat)
        link.mass = joint.mass_kg
        link.ipos = step_pos + centre
        link.iquat = step_quat
        link.inertia = joint.inertia_kg_m2
        link.explicitinertial = True
        inertia_at_servo = JOINT_ARMATURE_KGM2[i] + (0.5, 0.4, 0.2, 0.02, 0.02, 0.002)[i]
        stiffness = JOINT_STIFFNESS_NM[i]
        damping = 2 * JOINT_DAMPING_RATIO * np.sqrt(stiffness * inertia_at_servo)
        servo = spec.add_actuator(name=f"servo{i + 1}", target=f"joint{i + 1}", trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.gaintype, servo.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        servo.gainprm[0] = stiffness
        servo.biasprm[1], servo.biasprm[2] = -stiffness, -damping
        servo.forcelimited = True
        servo.forcerange = [-joint.torque_nm, joint.torque_nm]
        parent = link
    flange = parent.add_body(name="gripper", pos=step_pos, quat=step_quat)
    return flange


def _add_tool(spec: mujoco.MjSpec, gripper: "mujoco.MjsBody", part: Part, shape: PegShape) -> None:
    """Add gripper, sensor, compliance of the fingers, and peg. The sensor measures the load on the flange."""
    gripper.mass = GRIPPER_MASS_KG
    gripper.ipos = [0, 0, GRIPPER_COM_M]
    gripper.inertia = [1.1e-3, 1.0e-3, 6e-4]
    gripper.explicitinertial = True
    gripper.add_site(name="ft", pos=[0, 0, 0])
    gripper.add_site(name="tcp", pos=[0, 0, TCP_OFFSET_M])
    # peg frame: origin at the centre of the bottom, z along the peg into the world; the fingers' axis passes the pads
    peg = gripper.add_body(name="peg", pos=[0, 0, TCP_OFFSET_M])
    peg.add_joint(
        name="finger",
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=[0, 1, 0],
        pos=[0, 0, -PROTRUSION_M - 0.01],
        stiffness=FINGER_STIFFNESS_NM,
        damping=FINGER_DAMPING_NMS,
        armature=2e-5,
        limited=True,
        range=[-FINGER_RANGE_RAD, FINGER_RANGE_RAD],
    )
    common = {
        "name": "peg",
        "contype": 1,
        "conaffinity": 0,
        "mass": PEG_MASS_KG,
        **_CONTACT,
    }
    height = part.peg_height_m
    if part.is_cylinder and shape == EXACT:
        peg.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CYLINDER, pos=[0, 0, -height / 2], size=[part.radius_m, height / 2, 0], **common
        )
    else:
        turned_over = vertices(part, shape) * [1.0, -1.0, 1.0]  # the peg frame is the hole's, turned over by Rx(π)
        spec.add_mesh(name="peg", uservert=turned_over.ravel())
        peg.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="peg", **common)
    spec.add_sensor(name="force", type=mujoco.mjtSensor.mjSENS_FORCE, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="ft")
    spec.add_sensor(name="torque", type=mujoco.mjtSensor.mjSENS_TORQUE, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="ft")
