"""The scripted search and the policy that asks for nothing: what they ask for, and that a world answers as expected."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from wire.arrays import Float32Array, FloatArray

pytest.importorskip("onnx", reason="needs the extra `training`")

from service.policy.model import Policy
from service.policy.observation import ObservationMode
from training.evaluation.baseline import ABOUT_ESTIMATE, ABOUT_NOMINAL_CENTRE, Search, scripted_search, still
from training.evaluation.evaluate import evaluate

MODELS = Path(__file__).parents[3] / "models"
STEPS = 110


@pytest.fixture(scope="module")
def search() -> Policy:
    return Policy(scripted_search())


def seen(
    step: npt.ArrayLike, offset: tuple[float, float] = (0, 0), height: float = 0, known: float = 1, yaw: float = 0
) -> Float32Array:
    """Observations (n, 6) at steps (n,)."""
    steps = np.atleast_1d(step)
    rest = np.tile([*offset, height, known, yaw], (len(steps), 1))
    return np.column_stack([steps / STEPS, rest]).astype(np.float32)


def asked(policy: Policy, observation: Float32Array) -> FloatArray:
    """Displacement (n, 4), tool frame: m and rad."""
    action, _ = policy.act(observation)
    return action * np.array([entry.limit for entry in policy.contract.action])


def test_it_goes_over_the_estimate_first(search: Policy) -> None:
    assert asked(search, seen(0, offset=(1e-3, -2e-3)))[0, :2] == pytest.approx([1e-3, -2e-3], abs=1e-8)


@pytest.mark.parametrize(("mode", "numbers"), [("VFTM", ABOUT_ESTIMATE), ("FTM", ABOUT_NOMINAL_CENTRE)])
def test_it_spirals_outwards_from_there_over_equal_areas_in_equal_times(mode: ObservationMode, numbers: Search) -> None:
    policy = Policy(scripted_search(mode))
    assert policy.contract.mode == mode
    steps = np.arange(numbers.begin, STEPS + 1)
    # the tip is 4 mm short of where it should be at most: beyond that the action is cut
    places = []
    place = np.zeros(2)
    for step in steps:
        for _ in range(8):
            place = place + asked(policy, seen(step, offset=(-place[0], -place[1])))[0, :2]
        places.append(place)
    x, y = np.array(places).T
    areas = (x**2 + y**2) / numbers.radius_m**2
    assert areas == pytest.approx((steps - steps[0]) / (steps[-1] - steps[0]), abs=1e-4)
    turned = np.unwrap(np.arctan2(y[1:], x[1:]))
    assert turned[-1] - turned[0] == pytest.approx(2 * np.pi * numbers.turns * (1 - np.sqrt(areas[1])), rel=1e-3)


def test_the_spiral_stands_still_in_the_room_while_the_tool_turns(search: Policy) -> None:
    for yaw in (-0.8, 0.3, 1.0):
        straight, turned = (asked(search, seen(60, yaw=y))[0, :2] for y in (0.0, yaw))
        cosine, sine = np.cos(yaw), np.sin(yaw)
        assert [cosine * turned[0] - sine * turned[1], sine * turned[0] + cosine * turned[1]] == pytest.approx(
            straight, abs=1e-6
        )


def test_the_yaw_is_swept_over_all_that_it_may_be_and_back(search: Policy) -> None:
    yaw, yaws = 0.0, []
    for step in range(STEPS):
        yaw += asked(search, seen(step, yaw=yaw))[0, 3]
        yaws.append(yaw)
    degrees = np.rad2deg(yaws)
    assert degrees[: ABOUT_ESTIMATE.begin + 1] == pytest.approx(0, abs=1e-3)
    assert np.abs(np.diff(degrees)).max() == pytest.approx(5, abs=0.01)
    assert (degrees.max(), degrees.min()) == (pytest.approx(62, abs=2.6), pytest.approx(-62, abs=2.6))
    assert degrees.max() > 60
    assert degrees.min() < -60


def test_a_tip_that_has_dropped_is_pressed_down_and_neither_moved_aside_nor_turned(search: Policy) -> None:
    at_the_top, in_the_hole = (asked(search, seen(60, (1e-3, 0), height, yaw=0.2))[0] for height in (-0.5e-3, -1.5e-3))
    assert np.abs(at_the_top[[0, 1, 3]]).min() > 1e-5
    assert in_the_hole == pytest.approx([0, 0, -1.5e-3, 0])
    before_contact = asked(search, seen(60, (1e-3, 0), -1.5e-3, known=0, yaw=0.2))[0]
    assert before_contact == pytest.approx(at_the_top)


def test_the_script_presses_so_lightly_that_the_law_makes_4_5_newtons_of_it(search: Policy) -> None:
    press = -asked(search, seen(50))[0, 2]
    assert press * search.contract.compliance.stiffness[2] == pytest.approx(4.5)


def test_the_policy_that_asks_for_nothing_asks_for_nothing() -> None:
    policy = Policy(still())
    observation = np.random.default_rng(0).normal(size=(50, policy.contract.observation_size)).astype(np.float32)
    assert not policy.act(observation)[0].any()
    assert policy.contract.dsl.mode == "paper"


def test_a_search_without_force_is_refused() -> None:
    with pytest.raises(ValueError, match="for VFTM and FTM"):
        scripted_search("VM")


def test_it_inserts_where_nothing_but_the_locks_own_search_does_not(search: Policy) -> None:
    found, lucky = (
        evaluate(policy, 2e-3, 10, conditions="easy", first_seed=500_000, cells=10, threads=1).successes
        for policy in (search, Policy(still()))
    )
    assert found >= 8
    assert lucky <= 3


@pytest.mark.parametrize(
    ("name", "written", "conditions"),
    [
        ("scripted-search", scripted_search(), "standard"),
        ("scripted-search-ftm", scripted_search("FTM"), "search"),
        ("still", still(), "standard"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_shipped_file_is_what_is_written_here_with_what_was_measured_of_it(
    name: str, written: bytes, conditions: str
) -> None:
    shipped, own = Policy.load(MODELS / f"{name}.onnx"), Policy(written)
    assert shipped.contract.model_copy(update={"evaluation": ()}) == own.contract
    assert {(f.conditions, f.clearance_m) for f in shipped.contract.evaluation} >= {
        (conditions, c) for c in (2e-3, 1.33e-3)
    }
    observation = np.random.default_rng(0).normal(scale=2e-3, size=(200, 6)).astype(np.float32)
    observation[:, 0] = np.linspace(0, 1, 200)
    assert np.array_equal(shipped.act(observation)[0], own.act(observation)[0])
