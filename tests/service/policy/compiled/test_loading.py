"""The compiled step is used where it is built from the present sources, and refuses what does not fit."""

import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from service.policy import compiled
from service.policy.compiled.policy_step import CompiledStep, policy_step
from service.policy.step import PolicyStep
from tests.service.policy.compiled.twins import LIMITS, Draws, contract, needs_the_extension, numbers, pair
from wire import extension

WITHOUT = "import sys; sys.modules['service.policy.compiled._step'] = None; "


def run(program: str) -> str:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_version_says_which_of_the_two_computes() -> None:
    program = "from cli.__main__ import app; app(['--version'])"
    assert run(program).splitlines()[1] == compiled.describe()
    told = run(WITHOUT + program)
    assert "policy steps: numpy, slower; the compiled step is not used, it is not built" in told
    assert "make -B setup" in told


def test_without_the_extension_numpy_computes_everything() -> None:
    program = (
        "from service.policy import compiled; from service.safety import pose; "
        "from tests.service.policy.compiled.twins import LIMITS, contract; "
        "from service.policy.compiled.policy_step import policy_step; "
        "print(type(policy_step(contract(), LIMITS)).__name__, compiled.yaw_and_tilt is pose.yaw_and_tilt, "
        "compiled.rotvec_from_yaw is pose.rotvec_from_yaw)"
    )
    assert run(WITHOUT + program).split() == ["PolicyStep", "True", "True"]


@needs_the_extension
def test_an_extension_of_other_sources_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    assert compiled.load() == (compiled.step, "")
    assert compiled.describe() == "policy steps: compiled"
    monkeypatch.setattr(extension, "digest", lambda _: "of a later file")
    assert compiled.load() == (None, "it was built from other sources")


@needs_the_extension
def test_a_contract_gets_the_compiled_step_and_numpys_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    assert type(policy_step(contract(), LIMITS)) is CompiledStep
    monkeypatch.setattr(compiled, "step", None)
    assert type(policy_step(contract(), LIMITS)) is PolicyStep


Change = Callable[[list[Any]], None]


def put(place: int, value: Any) -> Change:
    def change(given: list[Any]) -> None:
        given[place] = value

    return change


def put_in(place: int, inner: int, change_one: Callable[[Any], Any]) -> Change:
    def change(given: list[Any]) -> None:
        given[place] = tuple(change_one(one) if k == inner else one for k, one in enumerate(given[place]))

    return change


def put_constant(name: str, value: float) -> Change:
    """Change the first number of a constant."""

    def change(given: list[Any]) -> None:
        step = compiled.step
        assert step is not None
        lists = (step.LOCK_CONSTANTS, step.BOUNDS_CONSTANTS, step.ACTION_CONSTANTS, step.OBSERVATION_CONSTANTS)
        names = [one for sizes in lists for one, size in sizes.items() for _ in range(size)]
        given[0] = given[0].copy()
        given[0][names.index(name)] = value

    return change


def no_frames(given: list[Any]) -> None:
    """An observation of no numbers from frames of which there are none, though steps have been counted."""
    given[2], given[6] = np.array([], np.int64), given[6][:, :0]
    given[5] = (*given[5][:2], np.ones(4, np.int32))


@needs_the_extension
@pytest.mark.parametrize(
    ("function", "change", "text"),
    [
        ("observe", put(0, np.zeros(3)), "constants"),
        ("observe", put(0, [1.0]), "constants"),
        ("observe", put_constant("window_samples", 0.0), "no samples"),
        ("observe", put_constant("window_samples", np.nan), "no samples"),
        ("act", put_constant("column", 4.0), "no such column"),
        ("act", put_constant("column", -1e9), "no such column"),
        ("act", put_constant("column", np.nan), "no such column"),
        ("observe", put(1, np.array([99])), "no such entry"),
        ("observe", put(1, np.array([-1])), "no such entry"),
        ("observe", put(2, np.array([10**6])), "no such column"),
        ("observe", put(3, ()), "position"),
        ("observe", put_in(3, 0, lambda one: one[:, :2]), "position"),
        ("observe", put_in(3, 0, lambda one: one[0]), "frames"),
        ("observe", put_in(3, 4, lambda one: one[:3]), "nominal_hole"),
        ("observe", put_in(3, 10, lambda one: one.astype(np.float64)), "phase"),
        ("observe", put(4, np.zeros((6, 4, 5))), "wrench_window"),
        ("observe", put(4, np.zeros((0, 4, 6))), "wrench_window"),
        ("observe", put(4, np.zeros((6, 6))), "wrench_window"),
        ("observe", put(5, ()), "tuple of 3"),
        ("observe", put(6, np.zeros((4, 2, 2), np.float32)), "frames"),
        ("observe", no_frames, "frames"),
        ("observe", put_in(3, 1, lambda one: one.reshape(2, 2)), "yaw"),
        ("observe", put_in(3, 2, lambda one: one.T), "tilt"),
        ("observe", put_in(5, 0, lambda one: one.reshape(3, 4)), "hole_mean"),
        ("observe", put(4, np.zeros((6, 6, 4))), "wrench_window"),
        ("act", put_in(1, 5, lambda one: one[:, None]), "target_yaw"),
        ("act", put(0, np.zeros(3)), "constants"),
        ("act", put(1, None), "position"),
        ("act", put_in(1, 6, lambda one: one[:, :3]), "action"),
        ("act", put_in(1, 6, lambda one: one.astype(str)), "convert|type"),
        ("act", put(2, np.zeros((6, 4, 5))), "wrench_window"),
        ("act", put_in(3, 5, lambda one: one[:3]), "fresh"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(function: str, change: Change, text: str) -> None:
    fast, _ = pair(contract())
    draws = Draws(1, (4,))
    state, seen, calls = draws.state(fast), draws.seen(), {}

    class Recorder:
        def __getattr__(self, name: str) -> Callable[..., Any]:
            def call(*given: Any) -> Any:
                calls[name] = list(given)
                return getattr(compiled.step, name)(*given)

            return call

    fast._step = Recorder()
    fast.observe(state, seen)
    fast.act(state, seen, draws.action())
    given = calls[function]
    change(given)
    with pytest.raises((TypeError, ValueError), match=text):
        getattr(compiled.step, function)(*given)
    with pytest.raises(TypeError, match="arguments"):
        getattr(compiled.step, function)(*given, None)


@needs_the_extension
def test_poses_of_another_shape_are_refused() -> None:
    for bad in ([3.1, 0.0, 0.0], np.zeros((3, 2)), np.zeros(()), np.zeros(3, complex)):
        with pytest.raises(TypeError, match="rotvec"):
            compiled.yaw_and_tilt(bad)
    with pytest.raises((TypeError, ValueError)):
        compiled.rotvec_from_yaw("east")


@needs_the_extension
def test_no_argument_is_changed_and_no_result_shares_memory_with_one() -> None:
    fast, _ = pair(contract())
    draws = Draws(1, (4,))
    state, seen, action = draws.state(fast), draws.seen(), draws.action()
    before = [array.copy() for _, array in numbers((state, seen, action))]
    after, observed = fast.observe(state, seen)
    moved, decided = fast.act(state, seen, action)
    results = [after.memory, observed, moved.lock, decided]
    for (name, array), old in zip(numbers((state, seen, action)), before, strict=True):
        np.testing.assert_array_equal(array, old, err_msg=name)
        for other, result in numbers(tuple(results)):
            assert result is array or not np.shares_memory(result, array), (name, other)
