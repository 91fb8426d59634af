"""Gymnasium's view: the conventions its users expect, and that many cells at once are the same as one by one."""

import warnings
from typing import Any

import numpy as np
import pytest

gym = pytest.importorskip("gymnasium", reason="needs the extra `training`: pip install -e '.[training]'")
sb3_checker = pytest.importorskip("stable_baselines3.common.env_checker", reason="needs the extra `training`")

from gymnasium.utils.env_checker import check_env  # noqa: E402
from gymnasium.vector import AutoresetMode, SyncVectorEnv  # noqa: E402

import training  # noqa: E402, F401  # registers the environment
from sim_backend.world import rendering  # noqa: E402
from training.environment.peg_in_hole import PegInHoleEnv, PegInHoleVectorEnv  # noqa: E402

NAME = "dsl_assembly/PegInHole-v0"
VARIANTS: list[dict[str, Any]] = [
    {},
    {"mode": "VM"},
    {"mode": "FTM", "conditions": "search"},
    {"lock": "off", "reward": "paper"},
    {"lock": "sliding", "part": "cir", "clearance_m": (0.5e-3, 2e-3), "randomise_plant": True},
]


@pytest.fixture(scope="module")
def can_draw() -> bool:
    try:
        rendering.Renderer(width=16, height=16).close()
    except rendering.RenderingUnavailableError:
        return False
    return True


def actions(env: Any, steps: int, n: int | None = None, seed: int = 0) -> np.ndarray:
    shape = (env.action_space.shape[-1],)
    return np.random.default_rng(seed).uniform(-1, 1, (steps, *(() if n is None else (n,)), *shape)).astype(np.float32)


@pytest.mark.parametrize("settings", VARIANTS, ids=str)
def test_gymnasiums_own_checks_pass_without_a_warning(settings: dict[str, Any], can_draw: bool) -> None:
    env = gym.make(NAME, **settings)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=not can_draw)
    env.close()


@pytest.mark.parametrize("settings", VARIANTS[:2], ids=str)
def test_stable_baselines_own_checks_pass_without_a_warning(settings: dict[str, Any]) -> None:
    env = PegInHoleEnv(**settings)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sb3_checker.check_env(env)
    env.close()


@pytest.mark.parametrize("settings", VARIANTS, ids=str)
def test_everything_seen_in_an_episode_lies_in_the_declared_space(settings: dict[str, Any]) -> None:
    env = PegInHoleEnv(**settings)
    observation, info = env.reset(seed=3)
    assert set(info) == {"world_seed", "clearance_m"}
    for action in actions(env, 40):
        assert observation in env.observation_space
        observation, _, terminated, truncated, info = env.step(action)
        assert set(info) == {"is_success", "fault", "peak_force", "depth", "z_lock", "phase", "clamped"}
        if terminated or truncated:
            break
    assert observation.dtype == np.float32


def test_actions_are_a_float32_box_of_one() -> None:
    box = PegInHoleEnv().action_space
    assert (box.dtype, box.low.tolist(), box.high.tolist()) == (np.float32, [-1.0] * 4, [1.0] * 4)


def test_the_same_seed_plays_the_same_episode_and_another_another() -> None:
    env = PegInHoleEnv()
    first = env.reset(seed=5)
    second = env.reset()
    again = env.reset(seed=5)
    assert first[1] == again[1] != second[1]
    assert np.array_equal(first[0], again[0])
    assert np.array_equal(second[0], env.reset()[0])


def test_options_fix_the_world_and_the_clearance_of_one_episode() -> None:
    env = PegInHoleEnv()
    observation, info = env.reset(seed=1, options={"world_seed": 77, "clearance_m": 1.5e-3})
    assert info == {"world_seed": 77, "clearance_m": 1.5e-3}
    assert np.array_equal(observation, env.reset(seed=2, options={"world_seed": 77, "clearance_m": 1.5e-3})[0])
    assert env.reset()[1]["clearance_m"] == 2e-3


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"shape": "tr"}, "unknown reset option shape"),
        ({"clearance_m": 1.0}, "clearance_m must lie in"),
        ({"world_seed": -1}, "seed must be a non-negative"),
    ],
)
def test_options_that_no_world_can_be_built_from_are_refused_by_name(options: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        PegInHoleEnv().reset(options=options)


@pytest.mark.parametrize(
    ("settings", "error", "text"),
    [
        ({"mode": "VM", "lock": "paper"}, ValueError, "VM bypasses the lock"),
        ({"mode": "FTM"}, ValueError, "nominal centre"),
        ({"mode": "FTM", "conditions": "transfer"}, ValueError, "nominal centre"),
        ({"randomise_plant": True, "conditions": "transfer"}, ValueError, "their plant is given"),
        ({"clearance_m": 0.0}, ValueError, "clearance_m must lie in"),
        ({"force_ceiling_n": 51.0}, ValueError, "at most 50 N"),
        ({"part": "hexagon"}, ValueError, "task.part"),
        ({"shape": "tr"}, TypeError, "unknown setting shape"),
        ({"render_mode": "human"}, ValueError, "render_mode"),
    ],
)
def test_settings_that_do_not_go_together_are_refused(
    settings: dict[str, Any], error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=text):
        PegInHoleEnv(**settings)


def test_an_action_that_is_not_finite_or_has_another_shape_is_refused_and_nothing_moves() -> None:
    env = PegInHoleEnv()
    env.reset(seed=0)
    for bad in (np.array([0, 0, np.nan, 0]), np.zeros(3)):
        with pytest.raises(ValueError, match="finite actions of shape"):
            env.step(bad)
    other = PegInHoleEnv()
    other.reset(seed=0)
    assert np.array_equal(env.step(np.zeros(4))[0], other.step(np.zeros(4))[0])


def test_a_step_outside_an_episode_is_refused() -> None:
    env, many = PegInHoleEnv(max_episode_steps=1), PegInHoleVectorEnv(2)
    with pytest.raises(gym.error.ResetNeeded):
        env.step(np.zeros(4))
    with pytest.raises(gym.error.ResetNeeded):
        many.step(np.zeros((2, 4)))
    env.reset(seed=0)
    *_, truncated, _ = env.step(np.zeros(4))
    assert truncated
    with pytest.raises(gym.error.ResetNeeded):
        env.step(np.zeros(4))


def test_time_truncates_and_does_not_terminate() -> None:
    env = gym.make(NAME, clearance_m=0.1e-3)
    env.reset(seed=0)
    ends = [env.step(np.zeros(4, np.float32))[2:4] for _ in range(110)]
    assert ends == [(False, False)] * 109 + [(False, True)]


# --- many at once


def masked(info: dict[str, Any], cell: int) -> dict[str, Any]:
    """Return what the vectorised info says of one cell."""
    said: dict[str, Any] = {}
    for key, value in info.items():
        if not key.startswith("_") and info[f"_{key}"][cell]:
            said[key] = masked(value, cell) if isinstance(value, dict) else value[cell]
    return said


@pytest.mark.parametrize("settings", [{}, VARIANTS[2], VARIANTS[4]], ids=str)
def test_many_cells_play_what_single_environments_play_through_the_ends_of_episodes(settings: dict[str, Any]) -> None:
    settings = {**settings, "max_episode_steps": 6}
    native = PegInHoleVectorEnv(3, **settings)
    one_by_one = SyncVectorEnv([lambda: PegInHoleEnv(**settings)] * 3, autoreset_mode=AutoresetMode.SAME_STEP)
    assert native.single_observation_space == one_by_one.single_observation_space
    assert native.observation_space == one_by_one.observation_space
    assert native.action_space == one_by_one.action_space
    mine, theirs = native.reset(seed=4), one_by_one.reset(seed=4)
    assert np.array_equal(mine[0], theirs[0])
    ended = 0
    for action in actions(native, 15, 3):
        mine, theirs = native.step(action), one_by_one.step(action)
        for got, want in zip(mine[:4], theirs[:4], strict=True):
            assert np.array_equal(got, want)
        for cell in range(3):
            got, want = masked(mine[4], cell), masked(theirs[4], cell)
            assert got.keys() == want.keys()
            last, expected = got.pop("final_obs", None), want.pop("final_obs", None)
            ended += last is not None
            assert np.array_equal(last, expected) if last is not None else expected is None
            assert got == want
    assert ended == 6
    one_by_one.close()


def test_gymnasium_makes_the_native_vector_environment() -> None:
    env = gym.make_vec(NAME, num_envs=2, vectorization_mode="vector_entry_point", lock="sliding")
    assert isinstance(env.unwrapped, PegInHoleVectorEnv)
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert env.reset(seed=0)[0].shape == (2, env.single_observation_space.shape[0])
    assert env.unwrapped.contract.max_steps == 110
    env.close()


def test_options_give_each_cell_a_world_of_its_own() -> None:
    _, info = PegInHoleVectorEnv(3).reset(options={"world_seed": 10, "clearance_m": 1e-3})
    assert info["world_seed"].tolist() == [10, 11, 12]
    assert info["clearance_m"].tolist() == [1e-3] * 3


def test_a_list_of_seeds_is_one_for_each_cell() -> None:
    many = PegInHoleVectorEnv(2)
    assert many.reset(seed=[8, 3])[1]["world_seed"][1] == PegInHoleEnv().reset(seed=3)[1]["world_seed"]
    with pytest.raises(ValueError, match="2 environments"):
        many.reset(seed=[1, 2, 3])


# --- pictures


def test_a_frame_is_drawn_and_closing_twice_does_no_harm(can_draw: bool) -> None:
    env = PegInHoleEnv(render_mode="rgb_array")
    env.reset(seed=0)
    if not can_draw:
        with pytest.raises(rendering.RenderingUnavailableError, match="apt-get install"):
            env.render()
        pytest.skip("no EGL here")
    picture = env.render()
    assert picture is not None
    assert (picture.shape, picture.dtype) == ((360, 480, 3), np.uint8)
    assert picture.std() > 10
    env.close()
    env.close()
    many = PegInHoleVectorEnv(2, render_mode="rgb_array")
    many.reset(seed=0)
    frames = many.render()
    assert frames is not None
    assert np.array_equal(frames[0], picture)
    many.close()
    many.close()


def test_the_declared_frame_rate_is_that_of_the_steps() -> None:
    env = PegInHoleEnv()
    assert env.metadata["render_fps"] == pytest.approx(1 / env.contract.period_s)
