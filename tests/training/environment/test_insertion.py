"""The environment without a framework: what an episode can and cannot be won by, and that a batch is many of one."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from service.config import LimitsSection
from service.policy.observation import Measurement
from service.policy.step import command_bounds
from service.safety import bounds, dsl
from service.safety.pose import yaw_and_tilt
from sim_backend.world import world as world_module
from sim_backend.world.conditions import Episode
from sim_backend.world.parts import PARTS, hole_walls
from sim_backend.world.world import START_YAW_RAD
from tests.training.play import facts, play_towards_hole, random_actions, unit
from training.environment import design, insertion
from training.environment.insertion import GOAL_DEPTH_M, LIMITS, SUCCESS_DEPTH_M, Insertions
from wire import pose
from wire.records import Program
from wire.task import Task

EVERYONE = np.arange(3)
SETTING = {"TILT_RAD": "max_tilt_rad", "TORQUE_CEILING_NM": "torque_ceiling_nm"}
TASKS = [Task(seed, "tr", 2e-3, "standard", True) for seed in (11, 12, 13)]


def begun(n: int = 1, tasks: list[Task] | None = None, **contract: object) -> Insertions:
    cells = Insertions(design.contract_for(**contract), n)  # type: ignore[arg-type]
    cells.reset(np.arange(n), tasks or TASKS[:n])
    return cells


# --- what counts


def test_a_peg_that_goes_down_in_the_hole_succeeds_and_its_episode_ends_there() -> None:
    cells = begun(1, [Task(21, "tr", 2e-3)])
    outcome = play_towards_hole(cells)
    assert outcome.success[0]
    assert outcome.terminated[0]
    assert not outcome.truncated[0]
    assert not outcome.fault[0]
    assert outcome.depth[0] >= GOAL_DEPTH_M > SUCCESS_DEPTH_M
    assert cells.world.contained[0]
    assert outcome.reward[0] > 4


def test_a_peg_below_the_surface_but_beside_the_block_has_not_succeeded() -> None:
    cells = begun(1, [Task(21, "tr", 2e-3, "easy")], lock="off", max_steps=140)
    world = cells.world
    lower, upper = np.array(LIMITS.workspace)
    outward = world.hole_yaw[0] + hole_walls(PARTS["tr"], 2e-3)[:, 0]
    ways = np.column_stack([np.cos(outward), np.sin(outward)])
    places = np.clip(world.hole_position[0, :2] + 0.3 * ways, lower[:2] + 2e-3, upper[:2] - 2e-3)
    beyond = places[np.argmax(((places - world.hole_position[0, :2]) * ways).sum(-1))]
    outcome = None
    for _ in range(139):
        move = np.zeros((1, 4))
        move[0, :2] = beyond - world.position[0, :2]
        if np.linalg.norm(move[0, :2]) < 3e-3:
            move[0, 2] = -1.0
        outcome = cells.step(unit(cells, move))
        assert not outcome.terminated[0]
        assert not outcome.success[0]
        if outcome.depth[0] > GOAL_DEPTH_M:
            break
    assert outcome is not None
    assert outcome.depth[0] > GOAL_DEPTH_M
    assert not world.contained[0]
    for _ in range(int(140 - cells.steps[0])):
        outcome = cells.step(np.zeros((1, 4)))
    assert outcome.truncated[0]
    assert not outcome.success[0]


def test_time_alone_truncates() -> None:
    cells = begun(1, max_steps=3)
    ends = [cells.step(np.zeros((1, 4))) for _ in range(3)]
    assert [bool(o.truncated[0]) for o in ends] == [False, False, True]
    assert not any(o.terminated[0] for o in ends)


@pytest.mark.parametrize(("limit", "value"), [("TILT_RAD", 5e-3), ("TORQUE_CEILING_NM", 0.5)])
def test_what_else_a_cell_stops_for_ends_an_episode_as_a_fault(
    monkeypatch: pytest.MonkeyPatch, limit: str, value: float
) -> None:
    assert getattr(insertion, limit) == LimitsSection.model_fields[SETTING[limit]].default
    assert play_towards_hole(begun(1, [Task(21, "tr", 2e-3)])).success[0]
    monkeypatch.setattr(insertion, limit, value)
    outcome = play_towards_hole(begun(1, [Task(21, "tr", 2e-3)]))
    assert outcome.fault[0]
    assert outcome.terminated[0]
    assert not outcome.success[0]


def test_the_force_ceiling_ends_an_episode_as_a_fault_and_never_as_a_success() -> None:
    cells = Insertions(design.contract_for(), 1, force_ceiling_n=6.0)
    cells.reset(np.arange(1), [Task(21, "tr", 0.5e-3, randomise_plant=False)])
    for _ in range(60):
        outcome = cells.step(np.array([[0.0, 0.0, -1.0, 0.0]]))
        if outcome.terminated[0]:
            break
    assert outcome.fault[0]
    assert outcome.peak_force[0] > 6.0
    assert not outcome.success[0]
    assert outcome.reward[0] < -1
    assert cells.world.arm.program[0] != Program.ENGAGED


# --- what is seen


@pytest.fixture
def other_world(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[Episode], Episode]], None]:
    """Change every episode that is drawn from now on."""
    drawn = world_module.draw

    def change(edit: Callable[[Episode], Episode]) -> None:
        monkeypatch.setattr(world_module, "draw", lambda task: edit(drawn(task)))

    return change


def first_observations(mode: str) -> list[np.ndarray]:
    cells = Insertions(design.contract_for(mode), 1)  # type: ignore[arg-type]
    task = Task(31, "tr", 2e-3, "easy")
    return [
        cells.reset(np.arange(1), [task]).copy(),
        *(cells.step(a).observation for a in random_actions(3, (1, 4))),
    ]


@pytest.mark.parametrize("mode", ["VFTM", "FTM", "VM"])
def test_before_contact_nothing_seen_depends_on_the_holes_yaw(
    mode: str, other_world: Callable[[Callable[[Episode], Episode]], None]
) -> None:
    before = first_observations(mode)
    other_world(lambda episode: replace(episode, hole_yaw=episode.hole_yaw + 0.4))
    assert np.array_equal(before, first_observations(mode))


def test_before_contact_nothing_seen_depends_on_the_true_hole_only_on_its_estimate(
    other_world: Callable[[Callable[[Episode], Episode]], None],
) -> None:
    before = first_observations("VFTM")
    shift = np.array([1e-3, -2e-3, 1e-3])
    other_world(lambda e: replace(e, hole_position=e.hole_position + shift, estimate_offset=e.estimate_offset - shift))
    assert np.allclose(before, first_observations("VFTM"), rtol=0, atol=1e-6)


def test_ftm_starts_above_the_nominal_centre_and_never_sees_the_estimate(
    other_world: Callable[[Callable[[Episode], Episode]], None],
) -> None:
    before = first_observations("FTM")
    other_world(lambda e: replace(e, estimate_offset=e.estimate_offset + 5e-3, hole_position=e.hole_position - 4e-3))
    assert np.array_equal(before, first_observations("FTM"))


def test_what_is_seen_is_what_the_deployed_service_makes_of_the_same_samples() -> None:
    """The lock, the bounds and the observation of one cell, run unbatched on the samples of a batched one."""
    cells = begun(3)
    contract, world = cells.contract, cells.world
    builder, action_map = contract.observation_builder(), contract.action_map()
    limits = command_bounds(LIMITS, contract.period_s, START_YAW_RAD)
    memory, lock = builder.begin(), dsl.DslState.begin()
    window = np.zeros((contract.ticks_per_step, 6))
    target, target_yaw = world.position[1].copy(), float(pose.yaw_of(world.rotation[1]))
    previous = np.zeros(4)
    samples: list[np.ndarray] = []
    advance = world.tick

    def tick() -> None:
        advance()
        samples.append(world.sensor.wrench[1].copy())

    world._together = None  # every tick is looked at
    world.tick = tick

    def observe() -> np.ndarray:
        nonlocal memory
        yaw, tilt = yaw_and_tilt(pose.rotvec_from_rotation(world.rotation[1]))
        memory, seen = builder.build(
            memory,
            Measurement(
                position=world.position[1],
                yaw=yaw,
                tilt=tilt,
                wrench_window=window,
                hole_estimate=world.estimate[1],
                nominal_hole=np.zeros(3),
                target_position=target,
                target_yaw=np.asarray(target_yaw),
                start_yaw=np.asarray(START_YAW_RAD),
                z_lock=lock.z_lock,
                contact_z=lock.z_contact0,
                phase=lock.phase,
                previous_action=previous,
                last_joint=np.asarray(world.joints[1, 5]),
            ),
        )
        return seen

    touched = False
    np.testing.assert_allclose(cells.observation[1], observe(), rtol=0, atol=1e-6)
    for actions in random_actions(45, (3, 4)):
        position, yaw = world.position[1].copy(), float(pose.yaw_of(world.rotation[1]))
        displacement = action_map.displacement(actions[1], yaw)
        lock, locked = dsl.step(
            contract.dsl, lock, position, window[-contract.wrench_window_ticks :].mean(0), displacement
        )
        bounded = bounds.apply(limits, position, yaw, locked.position, yaw + locked.dyaw, target, target_yaw)
        target, target_yaw, previous = bounded.position, float(bounded.yaw), action_map.unit(actions[1])
        samples.clear()
        outcome = cells.step(actions)
        window = np.array(samples)
        touched |= bool(locked.contact)
        np.testing.assert_allclose(outcome.observation[1], observe(), rtol=0, atol=1e-6)
    assert touched


# --- a batch is many of one


@pytest.mark.parametrize("lock", ["paper", "sliding", "off"])
def test_a_cell_does_the_same_alone_and_in_a_batch_bit_for_bit(lock: str) -> None:
    together = begun(3, lock=lock)
    alone = [begun(1, [task], lock=lock) for task in TASKS]
    for cell, single in enumerate(alone):
        assert np.array_equal(together.observation[cell], single.observation[0])
    for actions in random_actions(20, (3, together.action_size)):
        batch = facts(together.step(actions))
        for cell, single in enumerate(alone):
            for name, value in facts(single.step(actions[cell : cell + 1])).items():
                assert np.array_equal(batch[name][cell], value[0], equal_nan=name == "z_lock"), name


def test_resetting_one_cell_leaves_the_others_as_they_were() -> None:
    disturbed, undisturbed = begun(3), begun(3)
    actions = random_actions(16, (3, 4))
    for action in actions[:8]:
        disturbed.step(action)
        undisturbed.step(action)
    before = disturbed.observation.copy()
    after = disturbed.reset(np.array([1]), [Task(99, "tr", 1e-3)])
    assert np.array_equal(before[[0, 2]], after[[0, 2]])
    assert not np.array_equal(before[1], after[1])
    for action in actions[8:]:
        one, other = facts(disturbed.step(action)), facts(undisturbed.step(action))
        for name in one:
            assert np.array_equal(one[name][[0, 2]], other[name][[0, 2]], equal_nan=name == "z_lock"), name


def test_an_episode_leaves_nothing_behind_in_the_next() -> None:
    fresh, used = begun(1), begun(1)
    for action in random_actions(30, (1, 4), seed=5):
        used.step(action)
    assert np.array_equal(fresh.observation, used.reset(np.arange(1), TASKS[:1]))
    for action in random_actions(15, (1, 4)):
        one, other = facts(fresh.step(action)), facts(used.step(action))
        for name in one:
            assert np.array_equal(one[name], other[name], equal_nan=name == "z_lock"), name


# --- what only training varies


def test_a_hole_slips_once_in_a_training_episode_earns_nothing_by_it_and_the_camera_does_not_notice() -> None:
    slipping, still = Insertions(design.contract_for(), 1, slips=1.0), Insertions(design.contract_for(), 1)
    for cells in (slipping, still):
        cells.reset(np.arange(1), TASKS[:1])
    moves, up = 0, np.array([[0.0, 0.0, 1.0, 0.0]])
    for _ in range(80):
        before = slipping.world.hole_position.copy(), slipping.world.hole_yaw.copy()
        outcome, other = slipping.step(up), still.step(up)
        moved = not np.array_equal(before[0], slipping.world.hole_position)
        assert moved == (before[1][0] != slipping.world.hole_yaw[0])
        moves += moved
        assert outcome.reward == pytest.approx(other.reward, abs=0.02)  # the jump itself would be worth more than 0.1
        assert np.array_equal(slipping.world.estimate, still.world.estimate)
    assert moves == 1
    assert slipping.world.hole_position[0, 2] == still.world.hole_position[0, 2]


def test_a_policy_misreads_the_torque_about_z_alone_and_nothing_else_does() -> None:
    contract = design.contract_for()
    misled, plain = Insertions(contract, 3, misreads=1.0), Insertions(contract, 3)
    entries = [(e.name, i % e.size) for e in contract.observation for i in range(e.size * e.history)]
    torque = np.array([entry == ("torque_mean", 2) for entry in entries])
    for cells in (misled, plain):
        cells.reset(EVERYONE, TASKS)
    press = np.broadcast_to([0.3, 0.2, -1.0, 0.4], (3, 4))
    for _ in range(25):
        outcome, other = misled.step(press), plain.step(press)
        assert np.array_equal(misled.world.position, plain.world.position)
        assert np.array_equal(outcome.z_lock, other.z_lock, equal_nan=True)
        assert np.array_equal(outcome.observation[:, ~torque], other.observation[:, ~torque])
    factor = outcome.observation[:, torque] / other.observation[:, torque]
    assert np.ptp(factor, axis=1) == pytest.approx(0.0, abs=1e-3)
    assert (np.abs(factor) < 1.0).all()
    assert np.ptp(factor[:, 0]) > 0.1
