"""A stop is confirmed by measurement, repeated while the arm stays engaged, and escalated at its deadline."""

from types import SimpleNamespace

import numpy as np
import pytest

from service.cell.standstill import STOP_AGAIN_TICKS, Standstill
from service.drivers.base import Program
from service.safety.stop import StopState
from service.safety.witness import Witness, WitnessParameters

STILL = np.zeros(6)
MOVING = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
DEADLINE_S = 0.5
TICK_S = 0.002


class Arm:
    """A driver that notes what it is told, and its samples."""

    def __init__(self) -> None:
        self.seq = 0
        self.told: list[str] = []
        self.wrench = np.zeros(6)

    def clock(self) -> float:
        return self.seq * TICK_S

    def stop(self) -> None:
        self.told.append("stop")

    def stop_blind(self) -> None:
        self.told.append("stop blind")

    def escalate(self) -> None:
        self.told.append("escalate")

    def sample(self, program: Program, velocity: np.ndarray = STILL) -> SimpleNamespace:
        self.seq += 1
        return SimpleNamespace(
            program=program,
            tcp_velocity=velocity,
            arrival_s=self.clock(),
            seq=self.seq,
            wrench=self.wrench,
            joint_force=np.zeros(3),
        )


@pytest.fixture
def arm() -> Arm:
    return Arm()


@pytest.fixture
def standstill(arm: Arm) -> Standstill:
    return Standstill(arm, DEADLINE_S)  # type: ignore[arg-type]


def after(seconds: float, standstill: Standstill, arm: Arm, program: Program, velocity: np.ndarray) -> StopState:
    """Return the stop's state after this time of the same sample."""
    state = StopState.WAITING
    for _ in range(round(seconds / TICK_S)):
        state = standstill.on_sample(arm.sample(program, velocity))  # type: ignore[arg-type]
    return state


def test_nothing_is_awaited_before_a_stop_and_after_its_end(arm: Arm, standstill: Standstill) -> None:
    assert not standstill.awaited
    assert after(1.0, standstill, arm, Program.IDLE, STILL) is StopState.WAITING
    assert standstill.on_silence(arm.clock()) is StopState.WAITING
    standstill.begin()
    assert standstill.awaited
    standstill.end()
    assert not standstill.awaited
    assert arm.told == []


def test_an_arm_that_is_engaged_before_any_stop_is_told_a_plain_one(arm: Arm, standstill: Standstill) -> None:
    for _ in range(STOP_AGAIN_TICKS):
        standstill.repeat_stop(arm.sample(Program.ENGAGED))  # type: ignore[arg-type]
    assert arm.told == ["stop"]


def test_an_arm_that_rests_is_confirmed(arm: Arm, standstill: Standstill) -> None:
    standstill.begin()
    assert after(0.1, standstill, arm, Program.IDLE, STILL) is StopState.CONFIRMED
    assert arm.told == []


@pytest.mark.parametrize("program", [Program.ENGAGED, Program.STOPPING])
def test_an_arm_whose_program_may_go_on_is_not_standing(arm: Arm, standstill: Standstill, program: Program) -> None:
    standstill.begin()
    assert after(0.4, standstill, arm, program, STILL) is StopState.WAITING


def test_the_stop_is_repeated_while_the_arm_stays_engaged(arm: Arm, standstill: Standstill) -> None:
    standstill.begin()
    after(0.1, standstill, arm, Program.ENGAGED, MOVING)
    assert arm.told == ["stop"] * (50 // STOP_AGAIN_TICKS)
    after(0.1, standstill, arm, Program.STOPPING, MOVING)
    assert arm.told == ["stop"] * (50 // STOP_AGAIN_TICKS)


def test_a_stop_without_standstill_is_escalated_at_its_deadline(arm: Arm, standstill: Standstill) -> None:
    standstill.begin()
    assert after(DEADLINE_S - 2 * TICK_S, standstill, arm, Program.IDLE, MOVING) is StopState.WAITING
    assert "escalate" not in arm.told
    assert after(3 * TICK_S, standstill, arm, Program.IDLE, MOVING) is StopState.UNCONFIRMED
    assert "escalate" in arm.told


def test_silence_is_escalated_at_the_deadline_too(arm: Arm, standstill: Standstill) -> None:
    standstill.begin()
    assert standstill.on_silence(DEADLINE_S - TICK_S) is StopState.WAITING
    assert standstill.on_silence(DEADLINE_S + TICK_S) is StopState.UNCONFIRMED
    assert arm.told == ["escalate"]


def test_66_a_stop_whose_sensor_turns_out_to_lie_becomes_blind_and_stays_so(arm: Arm, standstill: Standstill) -> None:
    standstill.begin(Witness(WitnessParameters(12.0, 0.01, 6.0), TICK_S, np.zeros(3)))
    after(0.02, standstill, arm, Program.STOPPING, STILL)
    assert arm.told == []
    arm.wrench = np.array([0.0, 0.0, -20.0, 0.0, 0.0, 0.0])
    after(0.04, standstill, arm, Program.STOPPING, STILL)
    assert arm.told == ["stop blind"]
    standstill.stop()
    assert arm.told[-1] == "stop blind"
    standstill.begin()
    standstill.stop()
    assert arm.told[-1] == "stop"
    standstill.begin(blind=True)
    standstill.disbelieve()
    standstill.stop()
    assert arm.told[-1] == "stop blind"
