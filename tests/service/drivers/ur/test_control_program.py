"""The control program on a controller, with nothing of the driver between: registers in, motion out."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from service.drivers.ur import registers
from service.drivers.ur.program import RETRACT_SPEED_M_S, STOP_S, render
from service.drivers.ur.registers import Command
from sim_backend.ur_controller.assembly import make_controller
from sim_backend.ur_controller.events import Event
from sim_backend.ur_controller.plant import Plant
from sim_backend.world import quaternion
from sim_backend.world.compliance import Law, Reference, advance
from sim_backend.world.world import World
from tests.service.drivers.ur.cells import ur_config
from training.environment.design import LAW
from wire.records import TICK_S, Program, StopReason
from wire.rtde.modes import RuntimeState
from wire.task import Task

LIMITS = ur_config().limits
STIFFNESS, DAMPING, INERTIA = LAW.stiffness, LAW.damping, LAW.inertia


class Arm:
    """A controller with the control program, and a client that writes all of its registers in every tick."""

    def __init__(self, *, ur: dict[str, Any] | None = None, limits: dict[str, Any] | None = None) -> None:
        self.plant = Plant(World(1, "tr"))
        self.plant.lay_out(Task(3, conditions="easy"))
        self.controller = make_controller(self.plant)
        self.events: list[Event] = []
        self.controller.events.append(self.events.append)
        self.program = render(ur_config(ur=ur, limits=limits))
        self.sequence = 0
        self.values: tuple[float, ...] = registers.input_values(0, Command.NONE, ())
        self.silent = False

    def start(self) -> "Arm":
        self.tick(10)
        self.controller.run_script(self.program.text)
        self.tick(10)
        assert self.echo("CRC") == self.program.crc, self.events
        return self

    def order(self, command: Command, arguments: Sequence[float] = ()) -> int:
        self.sequence += 1
        self.values = registers.input_values(self.sequence, command, arguments)
        self.tick(8)
        return self.sequence

    def tick(self, ticks: int = 1) -> None:
        for _ in range(ticks):
            if not self.silent:
                self.controller.apply_inputs(registers.INPUT_NAMES, self.values)
            self.controller.tick()

    def zero(self) -> None:
        self.tick(300)
        number = self.order(Command.ZERO_FT)
        assert self.echo("ACCEPTED") == number

    def engage(self, **changes: Any) -> int:
        return self.order(Command.ENGAGE, engage_arguments(**changes))

    def engaged(self, **changes: Any) -> "Arm":
        self.start().zero()
        self.engage(**changes)
        assert self.state == (Program.ENGAGED, StopReason.NONE)
        return self

    def go(self, dx: float = 0.0, dy: float = 0.0, dz: float = 0.0) -> int:
        """Ask for a target beside the one in force."""
        x, y, z, *turn = self.target
        return self.order(Command.TARGET, [x + dx, y + dy, z + dz, *turn])

    def press(self, ticks: int = 3000) -> None:
        """Seek the block, a step at a time, until the program stops by itself."""
        for _ in range(ticks // 8):
            if self.state[0] is not Program.ENGAGED:
                return
            if self.target[2] > self.plant.tcp_pose()[2] - 0.02:
                self.go(dz=-0.002)
            else:
                self.go()
        raise AssertionError("nothing stopped it")

    def echo(self, name: str) -> int:
        return self.controller.output_registers.ints[getattr(registers, f"OUTPUT_{name}")]

    @property
    def state(self) -> tuple[Program, StopReason]:
        return Program(self.echo("PROGRAM")), StopReason(self.echo("REASON"))

    @property
    def target(self) -> list[float]:
        return list(self.controller.output_registers.doubles[registers.OUTPUT_TARGET :][:6])

    @property
    def peak_n(self) -> float:
        return self.controller.output_registers.doubles[registers.OUTPUT_PEAK]

    @property
    def speed(self) -> float:
        return math.hypot(*self.plant.tcp_speed()[:3])


def engage_arguments(
    stiffness: Sequence[float] = STIFFNESS,
    damping: Sequence[float] = DAMPING,
    inertia: Sequence[float] = INERTIA,
    max_speed: Sequence[float] = (0.1, 3.0),
    max_step: Sequence[float] = (0.012, 0.3),
    ceiling: float = 30.0,
    age: float = 0.3,
) -> list[float]:
    return [*stiffness, *damping, *inertia, *max_speed, *max_step, ceiling, age]


@pytest.mark.parametrize("about", ["flange", "tcp"])
def test_it_moves_the_arm_as_the_simulated_arm_s_law_does(about: str) -> None:
    """Tick by tick against `sim_backend/world/compliance.py`, in free air, in contact, in translation and rotation."""
    arm = Arm(ur={"torque_about": about})
    if about == "tcp":
        arm.plant.flange_wrench = lambda: arm.plant.wrench.tolist()  # type: ignore[method-assign]
    arm.start().zero()
    rows = [np.array([row]) for row in (STIFFNESS, DAMPING, INERTIA)]
    law = Law(*rows, np.array([[0.1, 3.0]]))
    start = np.array(arm.controller.motion.target_tcp_pose())
    reference = Reference(start[None, :3].copy(), quaternion.from_rotvec(start[None, 3:]), np.zeros((1, 6)))
    deepest = start[2] - arm.plant.truth()["hole_position"][2] + 0.003
    deviations = []
    arm.sequence += 1
    arm.values = registers.input_values(arm.sequence, Command.ENGAGE, engage_arguments())
    for tick in range(2000):
        wrench = arm.plant.wrench.copy()
        arm.tick()
        if arm.state[0] is not Program.ENGAGED:
            assert not deviations, arm.state
            continue
        target = np.array(arm.target)
        advance(law, reference, target[None, :3], quaternion.from_rotvec(target[None, 3:]), wrench[None])
        pose = np.array(arm.controller.motion.target_tcp_pose())
        turn = quaternion.between(quaternion.from_rotvec(pose[None, 3:]), reference.quaternion)
        deviations.append([*(pose[:3] - reference.position[0]), *turn[0]])
        if tick % 25 == 0:  # down onto the block beside the hole, turning and swaying
            step = tick // 25
            way = [min(0.001 * step, 0.02), 0.02 * math.sin(0.1 * step), -min(0.003 * step, deepest)]
            turned = quaternion.to_rotvec(_tool_down(0.1 * math.sin(0.3 * step)))[0]
            arm.sequence += 1
            arm.values = registers.input_values(arm.sequence, Command.TARGET, [*(start[:3] + way), *turned])
    away = np.abs(deviations).max(0)
    assert len(deviations) > 700
    assert arm.peak_n > 5.0, "it was in contact"
    assert away[:3].max() < 2e-6, away
    assert away[3:].max() < 2e-5, away


def _tool_down(yaw: float):
    """Rz(yaw) · Rx(π) as a quaternion, (1, 4)."""
    return np.array([[0.0, math.cos(yaw / 2), math.sin(yaw / 2), 0.0]])


@pytest.mark.parametrize(
    "changes",
    [
        {"stiffness": (3000.1, *STIFFNESS[1:])},
        {"stiffness": (*STIFFNESS[:5], -1.0)},
        {"stiffness": (math.nan, *STIFFNESS[1:])},
        {"damping": (59.9, *DAMPING[1:])},
        {"damping": (math.inf, *DAMPING[1:])},
        {"damping": (*DAMPING[:5], 5.1)},
        {"inertia": (*INERTIA[:5], 0.001)},
        {"inertia": (10.1, *INERTIA[1:])},
        {"inertia": (math.nan, *INERTIA[1:])},
        {"max_speed": (0.11, 3.0)},
        {"max_speed": (0.1, 3.1)},
        {"max_step": (0.013, 0.3)},
        {"max_step": (0.012, math.nan)},
        {"ceiling": 30.5},
        {"ceiling": 0.0},
        {"ceiling": math.nan},
        {"age": 0.31},
        {"age": 0.0},
        {"age": math.nan},
    ],
)
def test_a_law_or_limit_beyond_the_cell_s_is_refused_and_nothing_moves(changes: dict[str, Any]) -> None:
    arm = Arm().start()
    before = arm.plant.tcp_pose()
    number = arm.engage(**changes)
    assert arm.state == (Program.IDLE, StopReason.TARGET_REJECTED)
    assert arm.echo("HANDLED") == number
    assert arm.echo("ACCEPTED") == 0
    arm.tick(50)
    assert arm.plant.tcp_pose() == pytest.approx(before, abs=1e-5)


@pytest.mark.parametrize(
    "change",
    [
        (0.0, 0.0, math.nan, 0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, math.nan, 0.0, 0.0),
        (math.inf, 0.0, 0.0, 0.0, 0.0, 0.0),
        (0.0, 0.0, -0.0125, 0.0, 0.0, 0.0),
        (0.008, 0.008, 0.008, 0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, 0.0, 0.6, 0.0),
        (0.0, 0.0, 0.0, 20.0, 0.0, 0.0),
    ],
)
def test_a_target_that_is_no_pose_or_too_far_stops_the_arm(change: Sequence[float]) -> None:
    arm = Arm().engaged()
    arm.go(dz=-0.01)
    accepted = arm.echo("ACCEPTED")
    arm.order(Command.TARGET, [a + b for a, b in zip(arm.target, change, strict=True)])
    assert arm.state == (Program.STOPPING, StopReason.TARGET_REJECTED)
    assert arm.echo("ACCEPTED") == accepted
    arm.tick(80)
    assert arm.state == (Program.IDLE, StopReason.TARGET_REJECTED)
    assert arm.speed < 5e-4


def test_a_target_outside_the_box_stops_the_arm_although_it_is_near() -> None:
    lower, _ = LIMITS.workspace_m
    arm = Arm(limits={"workspace_m": ((0.295, lower[1], lower[2]), (0.305, 0.04, 0.4))}).engaged()
    arm.go(dx=0.004)
    assert arm.state[0] is Program.ENGAGED
    arm.go(dx=0.004)
    assert arm.state == (Program.STOPPING, StopReason.TARGET_REJECTED)


def test_an_order_is_carried_out_once_and_an_older_number_never() -> None:
    arm = Arm().engaged()
    first = arm.go(dz=-0.005)
    z = arm.target[2]
    arm.tick(30)
    assert arm.target[2] == z
    arm.values = registers.input_values(first - 1, Command.TARGET, [*arm.target[:2], z - 0.005, *arm.target[3:]])
    arm.tick(30)
    assert arm.target[2] == z
    assert arm.echo("ACCEPTED") == first


def test_what_an_earlier_client_left_in_the_registers_is_not_carried_out() -> None:
    arm = Arm()
    arm.sequence = 40
    arm.values = registers.input_values(40, Command.ENGAGE, engage_arguments())
    arm.start()
    arm.tick(50)
    assert arm.state == (Program.IDLE, StopReason.NONE)
    assert (arm.echo("HANDLED"), arm.echo("ACCEPTED")) == (40, 0)


def test_a_stop_decelerates_within_its_time_and_holds_where_the_arm_is() -> None:
    arm = Arm().engaged()
    for _ in range(20):
        arm.go(dz=-0.002)
    assert arm.speed > 0.02
    arm.order(Command.STOP)
    at = arm.plant.tcp_pose()
    assert arm.state == (Program.STOPPING, StopReason.COMMAND)
    arm.tick(round(STOP_S / TICK_S))
    assert arm.state == (Program.IDLE, StopReason.COMMAND)
    arm.tick(20)
    assert arm.speed < 5e-4
    assert np.abs(np.subtract(arm.plant.tcp_pose()[:3], at[:3])).max() < 4e-3


@pytest.mark.parametrize("blind", [False, True])
def test_66_a_blind_stop_does_not_yield_to_a_sensor_that_says_the_opposite(blind: bool) -> None:
    arm = Arm().engaged()
    at = arm.plant.tcp_pose()[2]
    honest = arm.plant.flange_wrench
    arm.plant.flange_wrench = lambda: [*honest()[:2], -12.0, *honest()[3:]]  # type: ignore[method-assign]
    arm.order(Command.STOP, [1.0] if blind else [])
    arm.tick(round(STOP_S / TICK_S) + 10)
    assert arm.state == (Program.IDLE, StopReason.COMMAND)
    moved_m = at - arm.plant.tcp_pose()[2]
    assert moved_m < 2e-4 if blind else moved_m > 5e-4


def test_a_stop_holds_for_as_long_as_it_stands_in_the_register_whatever_its_number() -> None:
    arm = Arm().engaged()
    arm.values = registers.input_values(1, Command.STOP, ())
    arm.tick(10)
    assert arm.state == (Program.STOPPING, StopReason.COMMAND)


@pytest.mark.parametrize("ceiling", [8.0, 15.0])
def test_the_force_ceiling_stops_the_arm_before_the_force_goes_far_beyond(ceiling: float) -> None:
    arm = Arm().engaged(ceiling=ceiling)
    arm.press()
    assert arm.state[1] is StopReason.FORCE_CEILING
    assert ceiling <= arm.peak_n
    true_peak_n = 0.0
    for _ in range(100):
        arm.tick()
        true_peak_n = max(true_peak_n, arm.plant.true_force)
    assert arm.state == (Program.IDLE, StopReason.FORCE_CEILING)
    assert true_peak_n < ceiling + 6.0
    assert arm.speed < 5e-4


def test_the_torque_ceiling_stops_the_arm() -> None:
    arm = Arm(limits={"torque_ceiling_nm": 0.9}).engaged()
    arm.plant.flange_wrench = lambda: [0.0, 0.0, 1.0, 0.0, 0.95, 0.0]  # type: ignore[method-assign]
    arm.tick(5)
    assert arm.state == (Program.STOPPING, StopReason.FORCE_CEILING)


def test_a_sensor_that_gives_no_number_stops_the_arm_and_moves_it_nowhere() -> None:
    arm = Arm().engaged()
    at = arm.plant.tcp_pose()
    arm.plant.flange_wrench = lambda: [math.nan] * 6  # type: ignore[method-assign]
    arm.tick(80)
    assert arm.state == (Program.IDLE, StopReason.FORCE_CEILING)
    assert arm.plant.tcp_pose()[:3] == pytest.approx(at[:3], abs=1e-3)
    assert math.isfinite(arm.peak_n)


def test_targets_that_do_not_come_any_more_stop_the_arm_although_the_client_lives() -> None:
    arm = Arm().engaged(age=0.1)
    arm.go(dz=-0.01)
    arm.tick(30)
    assert arm.state[0] is Program.ENGAGED
    arm.tick(20)
    assert arm.state == (Program.STOPPING, StopReason.TARGET_AGE)


def test_a_client_that_falls_silent_ends_the_program_and_the_arm_stands() -> None:
    arm = Arm().engaged()
    for _ in range(10):
        arm.go(dz=-0.002)
    assert arm.speed > 0.02
    arm.silent = True
    arm.tick(round(0.1 / TICK_S) + 5)
    assert arm.controller.runtime_state is not RuntimeState.PLAYING
    arm.tick(round(0.1 / TICK_S))
    assert arm.speed < 1e-3


def test_the_sensor_is_zeroed_at_rest_and_never_while_engaged() -> None:
    arm = Arm().engaged()
    refused = arm.order(Command.ZERO_FT)
    assert arm.echo("HANDLED") == refused
    assert arm.echo("ACCEPTED") < refused
    assert arm.state[0] is Program.ENGAGED


def test_the_sensor_is_not_zeroed_under_load() -> None:
    arm = Arm().start()
    arm.tick(300)
    loaded = [0.0, 0.0, 14.0, 0.0, 0.0, 0.0]
    arm.plant.flange_wrench = lambda: loaded  # type: ignore[method-assign]
    refused = arm.order(Command.ZERO_FT)
    assert (arm.echo("HANDLED"), arm.echo("ACCEPTED")) == (refused, 0)


def test_after_a_stop_by_force_the_arm_retracts_as_configured_and_after_another_it_does_not() -> None:
    arm = Arm(ur={"stop_retract_m": 0.004}).engaged(ceiling=10.0)
    arm.press()
    arm.tick(round(STOP_S / TICK_S))
    z = arm.plant.tcp_pose()[2]
    arm.tick(round(0.004 / RETRACT_SPEED_M_S / TICK_S) + 30)
    assert arm.state == (Program.IDLE, StopReason.FORCE_CEILING)
    assert arm.plant.tcp_pose()[2] - z == pytest.approx(0.004, abs=4e-4)
    arm.engage()
    arm.go(dz=0.01)
    arm.order(Command.STOP)
    arm.tick(round(STOP_S / TICK_S))
    z = arm.plant.tcp_pose()[2]
    arm.tick(150)
    assert arm.plant.tcp_pose()[2] == pytest.approx(z, abs=1e-4)


def test_a_retract_ends_where_the_tool_sticks() -> None:
    arm = Arm(ur={"stop_retract_m": 0.004}).engaged(ceiling=10.0)
    arm.press()
    arm.tick(round(STOP_S / TICK_S))
    z = arm.plant.tcp_pose()[2]
    arm.plant.flange_wrench = lambda: [0.0, 0.0, -arm.peak_n - 1.0, 0.0, 0.0, 0.0]  # type: ignore[method-assign]
    arm.tick(150)
    assert arm.state == (Program.IDLE, StopReason.FORCE_CEILING)
    assert arm.plant.tcp_pose()[2] - z < 1e-3


def test_the_peak_starts_anew_with_every_engagement() -> None:
    arm = Arm().engaged(ceiling=10.0)
    arm.press()
    assert arm.peak_n >= 10.0
    arm.tick(100)
    arm.engage(ceiling=30.0)
    first_n = arm.peak_n
    arm.go(dz=0.012)
    arm.tick(50)
    assert first_n < 10.0
