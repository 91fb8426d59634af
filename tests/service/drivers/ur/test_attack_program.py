"""Attacks on the control program: registers that change under it, obstacles above it."""

import math

import numpy as np
import pytest

from service.drivers.ur import registers
from service.drivers.ur.program import STOP_S
from service.drivers.ur.registers import Command
from sim_backend.ur_controller import inputs
from tests.service.drivers.ur.test_control_program import Arm, engage_arguments
from wire.records import TICK_S, Program, StopReason


def test_a_retract_that_came_free_does_not_push_an_obstacle_as_hard_as_what_it_came_from() -> None:
    arm = Arm(ur={"stop_retract_m": 0.004}).engaged(ceiling=10.0)
    feel = [0.0, 0.0, 25.0, 0.0, 0.0, 0.0]
    arm.plant.flange_wrench = lambda: list(feel)  # type: ignore[method-assign]
    arm.tick(3)
    assert arm.state == (Program.STOPPING, StopReason.FORCE_CEILING)
    feel[2] = 20.0
    arm.tick(round(STOP_S / TICK_S) + 4)
    feel[2] = 2.0
    arm.tick(20)
    assert arm.state[0] is Program.STOPPING, "it retracts"
    feel[2] = -12.0
    arm.tick(3)
    assert arm.state == (Program.IDLE, StopReason.FORCE_CEILING)


@pytest.mark.parametrize("argument", range(24))
def test_what_is_judged_at_engaging_is_what_is_taken(argument: int, monkeypatch) -> None:
    """A register that another client overwrites between two looks at it."""
    index = registers.INPUT_ARGUMENT + argument
    looks = 0
    is_watched = False

    class Doubles(list[float]):
        def __getitem__(self, at):
            nonlocal looks
            if is_watched and at == index:
                looks += 1
                if looks > 1:
                    return math.inf
            return super().__getitem__(at)

    made = inputs.Registers.__init__

    def watched(self) -> None:
        made(self)
        self.doubles = Doubles(self.doubles)

    monkeypatch.setattr(inputs.Registers, "__init__", watched)
    arm = Arm().start()
    arm.zero()
    is_watched = True
    arm.engage()
    assert looks == 1
    assert arm.state[0] is Program.ENGAGED


@pytest.mark.parametrize("command", list(Command))
def test_nothing_that_stands_in_the_registers_when_the_program_starts_moves_the_arm(command: Command) -> None:
    for sequence in (-(2**31), -1, 0, 1, 2**31 - 1):
        arm = Arm()
        arm.sequence = sequence
        arm.values = registers.input_values(sequence, command, engage_arguments())
        arm.start()
        before = arm.plant.tcp_pose()
        arm.tick(50)
        assert arm.state[0] is Program.IDLE
        assert np.linalg.norm(np.subtract(arm.plant.tcp_pose()[:3], before[:3])) < 1e-4
