"""`RTDEIOInterface` of ur_rtde sets what the controller holds, and other clients of ur_rtde see it."""

from collections.abc import Iterator

import numpy as np
import pytest
from rtde_control import RTDEControlInterface
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface

from tests.strangers.emulated_robot import EmulatedRobot, plus, until


@pytest.fixture(scope="module")
def io(robot: EmulatedRobot) -> Iterator[RTDEIOInterface]:
    client = RTDEIOInterface(robot.host)
    yield client
    client.disconnect()


@pytest.mark.parametrize(
    ("setter", "first_bit", "count"),
    [("setStandardDigitalOut", 0, 8), ("setConfigurableDigitalOut", 8, 8), ("setToolDigitalOut", 16, 2)],
)
def test_digital_outputs_follow_one_by_one(
    io: RTDEIOInterface, receive: RTDEReceiveInterface, setter: str, first_bit: int, count: int
) -> None:
    for output in range(count):
        bit = first_bit + output
        before = receive.getActualDigitalOutputBits()
        assert getattr(io, setter)(output, True)
        assert until(lambda bit=bit, before=before: receive.getActualDigitalOutputBits() == before | 1 << bit)
        assert receive.getDigitalOutState(bit)
    for output in range(count):
        assert getattr(io, setter)(output, False)
    assert until(lambda: receive.getActualDigitalOutputBits() == 0)


def test_analogue_outputs_are_a_fraction_of_their_range(io: RTDEIOInterface, receive: RTDEReceiveInterface) -> None:
    assert io.setAnalogOutputVoltage(0, 0.5)
    assert until(lambda: receive.getStandardAnalogOutput0() == pytest.approx(5.0))
    assert io.setAnalogOutputCurrent(1, 0.25)
    assert until(lambda: receive.getStandardAnalogOutput1() == pytest.approx(0.008))
    assert receive.getStandardAnalogOutput0() == pytest.approx(5.0)


def test_digital_inputs_are_read(robot: EmulatedRobot, receive: RTDEReceiveInterface) -> None:
    robot.set("terminals.digital_inputs", 0b1000)
    assert until(lambda: receive.getDigitalInState(3))
    assert receive.getActualDigitalInputBits() == 0b1000
    robot.set("terminals.digital_inputs", 0)
    assert until(lambda: not receive.getDigitalInState(3))


def test_input_registers_reach_the_controller(robot: EmulatedRobot, io: RTDEIOInterface) -> None:
    for register in (18, 19, 20, 21, 22):
        assert io.setInputIntRegister(register, 1000 + register)
        assert io.setInputDoubleRegister(register, 0.5 * register)
    assert until(lambda: robot.get("inputs.registers.doubles")[22] == 11.0)
    assert robot.get("inputs.registers.ints")[18:23] == [1018, 1019, 1020, 1021, 1022]
    assert robot.get("inputs.registers.doubles")[18:23] == [9.0, 9.5, 10.0, 10.5, 11.0]


def test_the_speed_slider_slows_what_another_client_moves(
    robot: EmulatedRobot, io: RTDEIOInterface, control: RTDEControlInterface, receive: RTDEReceiveInterface
) -> None:
    assert io.setSpeedSlider(0.4)
    try:
        assert until(lambda: receive.getTargetSpeedFraction() == pytest.approx(0.4))
        start = robot.truth().q
        with robot.recording() as recorded:
            assert control.moveJ(plus(start, 0, 0, 0, 0, 0, 0.2), 0.5, 5.0)
            path = recorded()
        assert np.abs(path.qd[:, 5]).max() == pytest.approx(0.2, rel=0.1)
        assert robot.truth().q[5] - start[5] == pytest.approx(0.2, abs=2e-3)
    finally:
        assert io.setSpeedSlider(1.0)
    assert until(lambda: receive.getTargetSpeedFraction() == pytest.approx(1.0))


def test_inputs_that_another_client_holds_are_refused(robot: EmulatedRobot, io: RTDEIOInterface) -> None:
    with pytest.raises(RuntimeError, match="already in use"):
        RTDEIOInterface(robot.host)


def test_a_control_client_on_the_upper_registers_stands_beside_them(robot: EmulatedRobot, io: RTDEIOInterface) -> None:
    robot.lay_out()
    flags = RTDEControlInterface.FLAG_UPLOAD_SCRIPT | RTDEControlInterface.FLAG_UPPER_RANGE_REGISTERS
    flags |= RTDEControlInterface.FLAG_NO_EXT_FT  # the client on the lower registers holds that input
    client = RTDEControlInterface(robot.host, 500.0, flags)
    try:
        start = robot.truth().q
        assert client.moveJ(plus(start, 0, 0, 0, 0, 0, 0.1), 1.0, 2.0)
        assert robot.truth().q[5] - start[5] == pytest.approx(0.1, abs=2e-3)
        assert robot.get("inputs.registers.doubles")[29] == pytest.approx(start[5] + 0.1)
        assert io.setInputIntRegister(20, 5)
        assert until(lambda: robot.get("inputs.registers.ints")[20] == 5)
        client.stopScript()
    finally:
        client.disconnect()
