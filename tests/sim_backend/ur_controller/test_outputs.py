"""Every RTDE output against what the simulation says otherwise."""

import struct

import numpy as np
import pytest

from sim_backend.ur_controller.geometry import compose, invert
from sim_backend.world import kinematics, scene
from wire.rtde.fields import OUTPUTS, FieldType

SWING = "movej([0.2, -1.4, -1.6, -1.5, 1.3, 0.5], a=6, v=3)"


@pytest.fixture
def moving(bench):
    """In the middle of a fast move."""
    bench.program(SWING)
    bench.run(180)
    assert np.abs(bench.plant.qd).max() > 0.3
    return bench


def test_every_variable_can_be_packed_as_its_type(bench):
    bench.run(1)
    for name, kind in OUTPUTS.items():
        value = bench.get(name)
        values = value if kind.count > 1 else [value]
        assert len(values) == kind.count, name
        assert struct.pack(f">{kind.count}{kind.letter}", *values), name
        assert kind is not FieldType.DOUBLE or isinstance(value, float), name


def test_joints_and_tool_agree_with_each_other_and_with_the_world(moving):
    q, qd = np.array(moving.get("actual_q")), np.array(moving.get("actual_qd"))
    assert q == pytest.approx(moving.plant.world.joints[0])
    pose = moving.get("actual_TCP_pose")
    flange, rotation = kinematics.forward(q)
    assert pose[:3] == pytest.approx(flange + rotation @ [0, 0, scene.TCP_OFFSET_M])
    assert moving.get("actual_TCP_speed") == pytest.approx(kinematics.jacobian(q, [0, 0, scene.TCP_OFFSET_M]) @ qd)
    assert moving.get("tcp_offset") == pytest.approx([0, 0, scene.TCP_OFFSET_M, 0, 0, 0])


def test_the_arm_follows_its_targets_closely(moving):
    assert moving.get("actual_q") == pytest.approx(moving.get("target_q"), abs=0.01)
    assert moving.get("actual_qd") == pytest.approx(moving.get("target_qd"), abs=0.1)
    apart = compose(moving.get("target_TCP_pose"), invert(moving.get("actual_TCP_pose")))
    assert np.abs(apart).max() < 0.02
    assert moving.get("actual_TCP_speed") == pytest.approx(moving.get("target_TCP_speed"), abs=0.1)
    assert 0.0 < moving.get("joint_position_deviation_ratio") < 0.2


def test_accelerations_are_the_changes_of_speeds(bench):
    bench.program("movej([0.2, -1.4, -1.6, -1.5, 1.3, 0.5], a=3, v=3)")
    bench.run(60)
    before, target_before = np.array(bench.get("actual_TCP_speed")), np.array(bench.get("target_qd"))
    bench.run(1)
    change = (np.array(bench.get("actual_TCP_speed")) - before) / 0.002
    assert np.abs(change).max() > 0.1
    assert bench.get("actual_TCP_acceleration") == pytest.approx(change)
    assert bench.get("target_qdd") == pytest.approx((np.array(bench.get("target_qd")) - target_before) / 0.002)
    assert np.abs(bench.get("target_TCP_acceleration")).max() > 0.1


def test_at_rest_the_accelerometer_reads_the_reaction_to_gravity(bench):
    bench.run(200)
    # the tool points down: up is along its -z
    assert bench.get("actual_tool_accelerometer") == pytest.approx([0, 0, -9.81], abs=0.05)


def test_the_momentum_is_the_moving_masses(moving):
    world = moving.plant.world
    links = [(joint.mass_kg, joint.com_m) for joint in kinematics.UR3E]
    q, qd = np.array(moving.get("actual_q")), np.array(moving.get("actual_qd"))

    def first_moment(angles):
        frame = np.eye(4)
        total = np.zeros(3)
        for joint, angle, (mass, com) in zip(kinematics.UR3E, angles, links, strict=True):
            c, s = np.cos(angle), np.sin(angle)
            ca, sa = np.cos(joint.alpha_rad), np.sin(joint.alpha_rad)
            step = [
                [c, -s * ca, s * sa, joint.a_m * c],
                [s, c * ca, -c * sa, joint.a_m * s],
                [0, sa, ca, joint.d_m],
                [0, 0, 0, 1],
            ]
            frame = frame @ step
            total += mass * (frame @ [*com, 1])[:3]
        return total + scene.PAYLOAD_KG * (frame @ [0, 0, scene.PAYLOAD_COM_M, 1])[:3]

    step = 1e-6
    wanted = np.linalg.norm((first_moment(q + step * qd) - first_moment(q - step * qd)) / (2 * step))
    assert world.n == 1
    assert moving.get("actual_momentum") == pytest.approx(wanted, rel=0.1)  # MuJoCo's is a tick old


def test_the_elbow_moves_as_its_velocity_says(moving):
    before, velocity = np.array(moving.get("elbow_position")), moving.get("elbow_velocity")
    moving.run(1)
    assert (np.array(moving.get("elbow_position")) - before) / 0.002 == pytest.approx(velocity, abs=0.03)
    shoulder = [0.0, 0.0, kinematics.UR3E[0].d_m]
    assert np.linalg.norm(before - shoulder) == pytest.approx(abs(kinematics.UR3E[1].a_m))


def test_force_is_given_about_the_flange_and_as_a_scalar(bench):
    bench.plant.place((0.30, -0.35, 0.006))
    bench.run(50)
    bench.finish("zero_ftsensor()")
    x, y, z, *turn = bench.plant.tcp_pose()
    goal = bench.controller.motion.joints_at([x + 0.001, y, z - 0.0065, *turn])
    bench.heard.clear()
    bench.finish(f"movej({goal}, t=0.5)")
    bench.run(20)
    force = bench.get("actual_TCP_force")
    assert force[2] > 3.0
    assert force[:3] == pytest.approx(bench.plant.wrench[:3])
    lever = np.array(bench.get("actual_TCP_pose")[:3]) - bench.plant.flange()[0]
    assert force[3:] == pytest.approx(bench.plant.wrench[3:] + np.cross(lever, force[:3]))
    assert bench.get("tcp_force_scalar") == pytest.approx(np.linalg.norm(force[:3]))
    assert bench.get("collision_detection_ratio") == pytest.approx(bench.plant.true_force / 150.0)
    # what the joints feel without the sensor: the force on the tool, as exactly as their friction allows
    assert bench.get("wrench_calc_from_currents")[2] == pytest.approx(force[2], abs=6.0)
    assert np.linalg.norm(bench.get("ft_raw_wrench")[:3]) > 3.0


def test_torques_and_currents_go_together(moving):
    torque = np.array(moving.get("actual_current_as_torque"))
    assert torque == pytest.approx(moving.plant.joint_torques())
    assert np.corrcoef(torque, moving.get("actual_current"))[0, 1] == pytest.approx(1.0)
    assert moving.get("actual_robot_current") > np.abs(moving.get("actual_current")).sum()


def test_what_a_program_configures_is_read_back(bench):
    bench.finish(
        "set_target_payload(1.5, [0.01, 0.02, 0.03], [1, 2, 3, 4, 5, 6])\n"
        "set_tcp(p[0.1, 0, 0.2, 0, 0.5, 0])\nset_gravity([0, 0, 1.62])\nset_tool_voltage(24)"
    )
    assert bench.get("payload") == 1.5
    assert bench.get("payload_cog") == [0.01, 0.02, 0.03]
    assert bench.get("payload_inertia") == [1, 2, 3, 4, 5, 6]
    assert bench.get("tcp_offset") == [0.1, 0, 0.2, 0, 0.5, 0]
    assert bench.get("target_gravity") == [0, 0, 1.62]
    assert bench.get("tool_output_voltage") == 24


def test_terminals_show_in_their_fields(bench):
    terminals = bench.controller.terminals
    terminals.digital_inputs = 0b11 << 8 | 1 << 16
    terminals.analog_inputs[:] = [1.0, 2.0, 3.0, 4.0]
    bench.finish("set_configurable_digital_out(2, True)\nset_standard_analog_out(1, 0.25)")
    assert bench.get("actual_digital_input_bits") == 0b11 << 8 | 1 << 16
    assert bench.get("actual_configurable_digital_input_bits") == 0b11 << 8
    assert bench.get("actual_digital_output_bits") == 1 << 10
    assert bench.get("actual_configurable_digital_output_bits") == 1 << 10
    assert [bench.get(f"standard_analog_input{i}") for i in (0, 1)] == [1.0, 2.0]
    assert [bench.get(f"tool_analog_input{i}") for i in (0, 1)] == [3.0, 4.0]
    assert bench.get("standard_analog_output1") == pytest.approx(0.008)


def test_bits_of_output_registers_come_one_by_one_and_as_words(bench):
    bench.finish(
        "write_output_boolean_register(1, True)\nwrite_output_boolean_register(33, True)\n"
        "write_output_boolean_register(127, True)"
    )
    assert bench.get("output_bit_registers0_to_31") == 0b10
    assert bench.get("output_bit_registers32_to_63") == 0b10
    assert bench.get("output_bit_register_127") is True
    assert bench.get("output_bit_register_126") is False


def test_a_value_is_the_same_however_often_it_is_asked_for_and_new_after_each_tick(moving):
    first = moving.get("target_TCP_pose")
    assert moving.get("target_TCP_pose") == first
    moving.run(1)
    assert moving.get("target_TCP_pose") != first
