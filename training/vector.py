"""The insertions as a vectorised environment of stable-baselines3, with a privileged view for the critic."""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from stable_baselines3.common.vec_env import VecEnv

from training.episodes import TaskSource
from training.insertion import PRIVILEGED_SIZE, Insertions


class InsertionVecEnv(VecEnv):
    """n cells that begin a new episode as soon as one ends.

    The observation is the policy's, in raw units, followed by `PRIVILEGED_SIZE` numbers for the critic alone;
    `training.network` separates them.
    """

    def __init__(self, insertions: Insertions, tasks: TaskSource, seed: int = 0) -> None:
        self._cells = insertions
        self._tasks = tasks
        self._rng = np.random.default_rng(seed)
        self._action = np.zeros((insertions.n, insertions.action_size))
        self._returns = np.zeros(insertions.n)
        self.render_mode = None
        size = insertions.observation_size + PRIVILEGED_SIZE
        super().__init__(
            insertions.n,
            gym.spaces.Box(-np.inf, np.inf, (size,), np.float32),
            gym.spaces.Box(-1.0, 1.0, (insertions.action_size,), np.float32),
        )

    def reset(self) -> npt.NDArray[np.float32]:
        self._cells.reset(np.arange(self.num_envs), self._tasks.draw(self._rng, self.num_envs))
        self._returns[:] = 0.0
        return self._observation()

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        self._action = actions

    def step_wait(
        self,
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.bool_], list[dict[str, Any]]]:
        outcome = self._cells.step(self._action)
        done = outcome.terminated | outcome.truncated
        self._returns += outcome.reward
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        observation = self._observation()
        ended = np.flatnonzero(done)
        for cell in ended:
            infos[cell] = {
                "terminal_observation": observation[cell],
                "TimeLimit.truncated": bool(outcome.truncated[cell]),
                "episode": {"r": float(self._returns[cell]), "l": int(self._cells.steps[cell]), "t": 0.0},
                "is_success": bool(outcome.success[cell]),
                "peak_force": float(outcome.peak_force[cell]),
                "fault": bool(outcome.fault[cell]),
            }
        if ended.size:
            self._returns[ended] = 0.0
            self._cells.reset(ended, self._tasks.draw(self._rng, ended.size))
            observation = observation.copy()
            observation[ended] = self._observation()[ended]
        return observation, outcome.reward.astype(np.float32), done, infos

    def seed(self, seed: int | None = None) -> list[int | None]:
        self._rng = np.random.default_rng(seed)
        return [seed] * self.num_envs

    def close(self) -> None:
        """Nothing is held open."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self, attr_name)] * len(self._indices(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        raise NotImplementedError(f"the cells step together and have no methods of their own, so not {method_name!r}")

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: Any = None) -> list[bool]:
        return [False] * len(self._indices(indices))

    def _indices(self, indices: Any) -> Sequence[int]:
        return range(self.num_envs) if indices is None else np.arange(self.num_envs)[indices].reshape(-1).tolist()

    def _observation(self) -> npt.NDArray[np.float32]:
        return np.concatenate([self._cells.observation, self._cells.privileged()], axis=1)
