"""Insertions in several processes behind one environment: numpy between physics ticks runs on one core per process."""

import contextlib
import multiprocessing
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import numpy.typing as npt
from stable_baselines3.common.vec_env import VecEnv

from training.vector import InsertionVecEnv

MakeEnvironment = Callable[[int], InsertionVecEnv]
"""Makes the environment of worker number i; must be picklable."""


class ParallelInsertions(VecEnv):
    """One `InsertionVecEnv` per worker process, stepped at the same time, seen as a single environment."""

    def __init__(self, make: MakeEnvironment, workers: int) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipes: list[Connection] = []
        self._processes: list[Any] = []
        for number in range(workers):
            ours, theirs = context.Pipe()
            process = context.Process(target=_work, args=(theirs, make, number), daemon=True)
            process.start()
            theirs.close()
            self._pipes.append(ours)
            self._processes.append(process)
        each, observations, actions = self._pipes[0].recv()
        for pipe in self._pipes[1:]:
            pipe.recv()
        self.render_mode = None
        super().__init__(each * workers, observations, actions)
        self._each = each

    def reset(self) -> npt.NDArray[np.float32]:
        for pipe in self._pipes:
            pipe.send(None)
        return np.concatenate([pipe.recv() for pipe in self._pipes])

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        for pipe, part in zip(self._pipes, np.split(actions, len(self._pipes)), strict=True):
            pipe.send(part)

    def step_wait(
        self,
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.bool_], list[dict[str, Any]]]:
        parts = [pipe.recv() for pipe in self._pipes]
        observations, rewards, dones, infos = zip(*parts, strict=True)
        return (
            np.concatenate(observations),
            np.concatenate(rewards),
            np.concatenate(dones),
            [info for part in infos for info in part],
        )

    def close(self) -> None:
        for pipe in self._pipes:
            pipe.close()
        for process in self._processes:
            process.join(timeout=5)
            if process.is_alive():
                process.terminate()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        raise NotImplementedError(
            f"the cells live in other processes and have no methods of their own: {method_name!r}"
        )

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


def _work(pipe: Connection, make: MakeEnvironment, number: int) -> None:
    """Work: send the shapes, then answer None with a reset and an action with a step until the pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which closes the pipe
    environment = make(number)
    with contextlib.suppress(EOFError, ConnectionError):  # the parent has ended
        pipe.send((environment.num_envs, environment.observation_space, environment.action_space))
        while True:
            action = pipe.recv()
            pipe.send(environment.reset() if action is None else environment.step(action))
