"""The compiled step and that of numpy give the same numbers, bit for bit, whatever they are given."""

from collections import defaultdict
from dataclasses import fields, replace

import numpy as np
import pytest

from service.policy import compiled, observation
from service.policy.compiled.policy_step import CompiledStep, policy_step
from service.policy.contract import PolicyContract
from service.policy.observation import Measurement, ObservationState
from service.policy.step import PolicyStep
from service.safety import pose
from service.safety.bounds import BoundedCommand, BoundsParameters
from service.safety.dsl import DslOutput, DslParameters, DslState
from tests.service.policy.compiled.twins import (
    LIMITS,
    MODES,
    NO_RANGE,
    ODD,
    SHIPPED,
    Draws,
    assert_the_same,
    contract,
    locks,
    needs_the_extension,
    numbers,
    pair,
)

pytestmark = needs_the_extension

SHAPES = [(), (1,), (7,), (64,), (256,), (2, 3)]


def run_both(made: PolicyContract, limits: BoundsParameters, draws: Draws, rounds: int, samples: int = 6) -> dict:
    """Run both on drawn states and compare everything; return which values each flag has had."""
    flags: dict[str, set[bool]] = defaultdict(set)
    fast, plain = pair(made, limits)
    for _ in range(rounds):
        with np.errstate(all="ignore"):
            state, seen, action = draws.state(plain), draws.seen(samples), draws.action()
            assert_the_same(fast.observe(state, seen), plain.observe(state, seen))
            mine, yours = fast.act(state, seen, action), plain.act(state, seen, action)
        assert_the_same(mine, yours)
        for name, value in numbers(mine):
            if value.dtype == np.bool_:
                flags[name.rpartition(".")[2]] |= set(value.ravel().tolist())
    return flags


@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_contract_is_played_the_same(name: str, shape: tuple[int, ...]) -> None:
    made = SHIPPED[name]
    fast, plain = pair(made)
    draws = Draws(1, shape)
    mine = yours = plain.begin(draws.place(1e-3), draws.normal(mean=2.9, spread=0.1))
    for _ in range(40):
        seen, action = draws.seen(50), draws.action()
        (mine, shown), (yours, same) = fast.observe(mine, seen), plain.observe(yours, seen)
        assert_the_same((mine, shown), (yours, same))
        (mine, decided), (yours, agreed) = fast.act(mine, seen, action), plain.act(yours, seen, action)
        assert_the_same((mine, decided), (yours, agreed))


@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("lock", locks(), ids=lambda lock: f"{lock.mode}-{lock.release_threshold}")
def test_every_lock_in_every_phase_takes_every_branch_the_same(lock: DslParameters, shape: tuple[int, ...]) -> None:
    flags = run_both(contract(lock=lock), LIMITS, Draws(2, shape), max(40, 400 // int(np.prod(shape))))
    both = {"contact", "saturated", "leash", "step", "speed", "workspace", "yaw_range", "tilt"}
    if lock.mode != "off":
        both |= {"clamped", "search_depth_exceeded", "search_time_exceeded"}
    if lock.mode == "paper":
        both |= {"edge"}
    assert both - {name for name, values in flags.items() if len(values) == 2} == set()


@pytest.mark.parametrize("mode", ["VFTM", "FTM", "VM"])
@pytest.mark.parametrize("first", range(5))
def test_every_entry_is_observed_the_same_in_every_mode(mode: observation.ObservationMode, first: int) -> None:
    for entries in (1, 4, 18):
        for samples in (1, 3, 6, 60):
            run_both(contract(mode, entries=entries, first=3 * first), NO_RANGE, Draws(first, (5,)), 6, samples)
            run_both(contract(mode, entries=entries, first=3 * first), NO_RANGE, Draws(first, ()), 6, samples)


@pytest.mark.parametrize("odd", [0.02, 0.3])
@pytest.mark.parametrize("limits", [LIMITS, NO_RANGE], ids=["a range of yaw", "none"])
@pytest.mark.parametrize("lock", locks(), ids=lambda lock: f"{lock.mode}-{lock.release_threshold}")
def test_numbers_that_no_cell_measures_lead_both_to_the_same(
    lock: DslParameters, limits: BoundsParameters, odd: float
) -> None:
    flags = run_both(contract(lock=lock, first=1), limits, Draws(3, (40,), odd), 30)
    run_both(contract(lock=lock, first=2), limits, Draws(4, (), odd), 100)
    assert flags["invalid"] == {True, False}


@pytest.mark.parametrize("name", SHIPPED)
def test_at_the_thresholds_themselves_both_decide_the_same(name: str) -> None:
    """A difference of one in the last place would show where a comparison is decided by it."""
    lock = SHIPPED[name].dsl
    fast, plain = pair(SHIPPED[name])
    draws = Draws(5, (64,))
    for _ in range(40):
        state, seen = draws.state(plain), draws.seen(50)
        fz = lock.force_clip_n * draws.rng.choice([lock.contact_threshold, 1.0, lock.delta_f[2]], 64)
        seen.wrench_window[..., :] = 0.0
        seen.wrench_window[..., 2] = fz + draws.rng.choice([0.0, 1e-15, -1e-15], 64)
        state.lock.previous_n[...] = 0.0
        state.lock.seek_start_z[...] = seen.position[..., 2] + lock.search_depth_m - lock.seek_step_m
        state.lock.seek_steps[...] = lock.search_steps - draws.rng.integers(0, 2, 64)
        state.target_position[...] = seen.position + np.array([LIMITS.leash_m, 0.0, 0.0])
        action = draws.action()
        assert_the_same(fast.act(state, seen, action), plain.act(state, seen, action))


def test_at_the_bounds_themselves_both_decide_the_same() -> None:
    """Everything is at zero, so a change of the command is the action's limit, without rounding."""
    limits = BoundsParameters(0.1, 8e-3, 0.1, 0.08, 1.0, 8e-3, 0.1, (-1, -8e-3, -8e-3), (8e-3, 1, 1), 0.0, 0.1, 0.05)
    made = contract(lock=DslParameters(mode="off"))
    entries = [entry.model_copy(update={"limit": 0.1 if entry.unit == "rad" else 8e-3}) for entry in made.action]
    fast, plain = pair(made.model_copy(update={"action": tuple(entries)}), limits)
    steps = [-1.0, np.nextafter(-1.0, 0.0), 0.0, 1.0, np.nextafter(1.0, 0.0)]
    action = np.stack(np.meshgrid(steps, steps, steps, steps), axis=-1).reshape(-1, 4)
    draws = Draws(7, (len(action),))
    zero = replace(draws.seen(), position=np.zeros((len(action), 3)), yaw=np.zeros(len(action)))
    state = plain.begin(zero.position, zero.yaw)
    for tilt in (0.05, np.nextafter(0.05, 0.0), np.nextafter(0.05, 1.0)):
        seen = replace(zero, tilt=np.tile([tilt, 0.0], (len(action), 1)))
        (_, decided), (_, agreed) = fast.act(state, seen, action), plain.act(state, seen, action)
        assert_the_same(decided, agreed)
        along_one = (np.abs(action).sum(-1) == 1.0) & (action[:, 0] == 0.0)  # a turn is rounded
        for flag in ("leash", "step", "speed", "workspace", "yaw_range"):
            assert not getattr(decided.bounded, flag)[along_one].any(), flag


def test_poses_are_the_same() -> None:
    draws = Draws(6, (20_000,))
    near_down = np.array([np.pi, 0.0, 0.0]) + draws.normal(3, spread=0.1)
    odd = np.stack(np.meshgrid(ODD, ODD, ODD), axis=-1).reshape(-1, 3)
    for rotvec in (near_down, draws.normal(3, spread=2.0), draws.normal(3, spread=1e-9), odd):
        with np.errstate(all="ignore"):
            assert_the_same(compiled.yaw_and_tilt(rotvec), pose.yaw_and_tilt(rotvec))
            for one in rotvec[:500]:
                assert_the_same(compiled.yaw_and_tilt(one), pose.yaw_and_tilt(one))
    yaw = draws.normal(spread=3.0)
    assert_the_same(compiled.rotvec_from_yaw(yaw), pose.rotvec_from_yaw(yaw))
    for one in yaw[:500]:
        assert_the_same(compiled.rotvec_from_yaw(float(one)), pose.rotvec_from_yaw(float(one)))


def test_names_and_order_are_those_of_the_specification() -> None:
    step = compiled.step
    assert step is not None

    def named(kind: type, *without: str) -> list[str]:
        return [field.name for field in fields(kind) if field.name not in without]

    assert list(step.MEASUREMENT) == named(Measurement, "wrench_window")
    assert list(step.MEMORY) == named(ObservationState, "frames")
    assert list(step.LOCK_STATE) == named(DslState, "z_floor")
    assert list(step.LOCK_OUTPUT) == named(DslOutput)
    assert list(step.BOUNDED) == named(BoundedCommand)
    clips = {"force_clip_n", "torque_clip_nm"}
    assert set(step.LOCK_CONSTANTS) == {"clip", *named(DslParameters)} - clips
    assert list(step.BOUNDS_CONSTANTS) == named(BoundsParameters)
    assert {name: spec.size for name, spec in observation.ENTRIES.items()} == step.ENTRIES
    assert MODES == ("paper", "sliding", "off"), "lock.h counts them in this order"


def test_a_contract_with_an_entry_that_the_extension_lacks_is_played_by_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    made = contract(entries=1)
    monkeypatch.setitem(observation.ENTRIES, "own", observation.ENTRIES["yaw"])
    own = made.model_copy(update={"observation": (made.observation[0].model_copy(update={"name": "own"}),)})
    assert type(policy_step(own, LIMITS)) is PolicyStep
    assert type(policy_step(made, LIMITS)) is CompiledStep
