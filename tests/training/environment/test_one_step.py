"""The cell's insertion and training's play the same episode: same observation, same lock, same target at every step."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from service.cell.insertion import Insertion
from service.cell.orders import Engage, Infer, Move
from service.cell.plan import plan_insertion
from service.cell.stages import Stage
from service.config import CellConfig, load
from service.drivers.base import Program, RobotMode, SafetyMode, Sample, StopReason
from service.policy.model import Policy
from service.safety.pose import rotvec_from_yaw
from sim_backend.world.world import World
from training.environment.insertion import Insertions
from wire import pose
from wire.arrays import FloatArray
from wire.records import TICK_S
from wire.task import Task

CONFIG: CellConfig = load(Path(__file__).parents[3] / "config" / "cell.toml")
RECIPE = next(iter(CONFIG.recipes.values()))
POLICY = Policy.load(RECIPE.policy)


class Shadow:
    """The cell's insertion of one world of training, fed with that world's samples."""

    def __init__(self, cells: Insertions) -> None:
        self.world: World = cells.world
        hover_m = float(cells.world.hover(np.arange(1))[0])
        self.plan = replace(plan_insertion(CONFIG, RECIPE, cells.contract), hover_m=hover_m)
        self.insertion = Insertion(self.plan)
        self.target = (self.plan.start_position, rotvec_from_yaw(self.plan.start_yaw))
        self.observation: FloatArray | None = None
        self._seq = 0
        self._rng = np.random.default_rng(0)

    def approach(self) -> None:
        """Stand at the start, pass the pre-flight, and follow every target exactly until the world takes over."""
        hole = self.world.estimate[0]
        program, engaged = Program.IDLE, False
        while self.insertion.stage is not Stage.INSERTING:
            arriving = np.allclose(self.target[0], self.world.position[0], rtol=0.0, atol=1e-12)
            noise = np.zeros(6) if engaged else self._rng.normal(0.0, [0.1, 0.1, 0.1, 1e-3, 1e-3, 1e-3])
            position, rotvec = self.target
            if arriving:
                position, rotvec = self.world.position[0], pose.rotvec_from_rotation(self.world.rotation[0])
            speed = np.array([0.0, 0.0, 0.05 if engaged and not arriving else 0.0, 0.0, 0.0, 0.0])
            sample = replace(self._sample(position, rotvec, noise, hole, program), tcp_velocity=speed)
            engaged |= Engage in map(type, self._take(sample))
            program = Program.ENGAGED if engaged else Program.IDLE

    def tick(self) -> None:
        """Take in the sample of the tick that the world has just made."""
        world = self.world
        rotvec = pose.rotvec_from_rotation(world.rotation[0])
        program = Program(int(world.arm.program[0]))
        self._take(self._sample(world.position[0], rotvec, world.sensor.wrench[0], world.estimate[0], program))

    def act(self, action: FloatArray) -> None:
        self._carry_out(self.insertion.take_action(action))

    def _sample(self, position: FloatArray, rotvec: FloatArray, wrench: FloatArray, hole: FloatArray, program: Program):
        self._seq += 1
        return Sample(
            epoch=1, episode=1, seq=self._seq, time_s=self._seq * TICK_S, arrival_s=self._seq * TICK_S,
            q=self.world.joints[0], qd=np.zeros(6), tcp_position=position.copy(), tcp_rotvec=rotvec.copy(),
            tcp_velocity=np.zeros(6), wrench=wrench.copy(), unzeroed=wrench.copy(),
            ft_raw=wrench.copy(), joint_force=None, saturated=False, hole_estimate=hole.copy(), program=program,
            stop_reason=StopReason.NONE, robot_mode=RobotMode.RUNNING, safety_mode=SafetyMode.NORMAL, command_seq=0,
            peak_force_n=0.0,
        )  # fmt: skip

    def _take(self, sample: Sample) -> list:
        return self._carry_out(self.insertion.on_sample(sample))

    def _carry_out(self, orders: list) -> list:
        for order in orders:
            match order:
                case Move(target):
                    self.target = (target.position, target.rotvec)
                case Infer(observation):
                    self.observation = observation
                case _:
                    assert not hasattr(order, "code"), order
        return orders


@pytest.mark.parametrize("seed", [2_000_000, 2_000_002, 2_000_003])
def test_the_cell_and_training_observe_lock_and_command_the_same_at_every_tick_and_step(seed: int) -> None:
    cells = Insertions(POLICY.contract, 1)
    observation = cells.reset(np.arange(1), [Task(seed, "tr", 1.33e-3)])
    shadow = Shadow(cells)
    shadow.approach()
    np.testing.assert_allclose(shadow.observation, observation[0], rtol=0.0, atol=1e-6)
    advance = cells.world.tick

    def tick() -> None:
        advance()
        shadow.tick()

    cells.world._together = None  # every tick is looked at
    cells.world.tick = tick  # pyright: ignore[reportAttributeAccessIssue]
    hidden = POLICY.initial_hidden((1,))
    pressed = 0
    for step in range(POLICY.contract.max_steps):
        action, hidden = POLICY.act(observation, hidden)
        shadow.act(action[0])
        outcome = cells.step(action)
        observation = outcome.observation
        record = shadow.insertion.last
        assert record is not None
        assert record.step == step
        assert int(record.dsl.phase) == outcome.phase[0]
        np.testing.assert_allclose(record.dsl.z_lock, outcome.z_lock[0], rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(record.bounded.position, cells.target_position[0], rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(record.bounded.yaw, cells.target_yaw[0], rtol=0.0, atol=1e-9)
        pressed += int(outcome.phase[0] == 1)
        if outcome.terminated[0]:
            break
        np.testing.assert_allclose(shadow.observation, observation[0], rtol=0.0, atol=1e-5)
    assert outcome.success[0]
    assert shadow.insertion.depth_m == pytest.approx(outcome.depth[0], abs=2.5e-3)
    assert pressed > 0


def test_an_answer_that_comes_late_acts_on_what_was_measured_when_it_was_asked_for() -> None:
    """The lock must not mix the asked sample's position with the wrench of a newer one."""
    cells = Insertions(POLICY.contract, 1)
    cells.reset(np.arange(1), [Task(2_000_000, "tr", 1.33e-3)])
    targets = []
    for late in (False, True):
        shadow = Shadow(cells)
        shadow.approach()
        if late:
            position, rotvec = cells.world.position[0], pose.rotvec_from_rotation(cells.world.rotation[0])
            for _ in range(20):  # a contact that begins while the policy thinks
                wrench = np.array([0.0, 0.0, 12.0, 0.0, 0.0, 0.0])
                shadow._take(shadow._sample(position, rotvec, wrench, cells.world.estimate[0], Program.ENGAGED))
        shadow.act(np.array([0.0, 0.0, -1.0, 0.0]))
        record = shadow.insertion.last
        assert record is not None
        assert not bool(record.dsl.contact)
        targets.append(replace(record.bounded))
    np.testing.assert_array_equal(targets[0].position, targets[1].position)
