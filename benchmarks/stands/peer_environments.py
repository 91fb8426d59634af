"""Environments to be compared, each in a process of its own: steps one of them and prints its figures as JSON.

It runs in any Python that has the environment, so it needs only the standard library, numpy and
`benchmarks.harness.stopwatch`.
"""

import importlib
import json
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.harness.stopwatch import timed

CELLS = 192
WARM_UP = 20
RESETS = 4
"""Number of resets requested before the steps; the first is not counted."""


@dataclass(slots=True)
class Taken:
    """Figures of stepping an environment.

    Attributes:
        cells: number of cells stepped at once.
        step_s: simulated time of an environment step.
        tick_s: simulated time of a physics step.
        versions: versions of the packages, in words.
        steps: environment steps of all cells.
        stepping_s: time of those steps, without resets.
        physics_s: part of that time in the physics engine's own step.
        resets: resets, one cell each.
        resets_s: time of the resets.
    """

    cells: int
    step_s: float
    tick_s: float
    versions: str
    steps: int = 0
    stepping_s: float = 0.0
    physics_s: float = 0.0
    resets: int = 0
    resets_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Environment:
    """An environment ready to be stepped.

    Attributes:
        low: lower bounds of an action; (k,), or (n, k) for several cells.
        high: upper bounds, likewise.
        reset: begins an episode in every cell.
        step: steps with such an action; returns the number of episodes that ended.
        physics: owner and name of each function that steps the physics.
        own_reset: owner and name of the function by which `step` itself resets; None if the caller must reset.
        taken: figures known before the steps.
    """

    low: npt.NDArray[Any]
    high: npt.NDArray[Any]
    reset: Callable[[], object]
    step: Callable[[npt.NDArray[Any]], int]
    physics: tuple[tuple[Any, str], ...]
    own_reset: tuple[Any, str] | None
    taken: Taken


def one_cell() -> Environment:
    """Return this project's Gymnasium environment."""
    _module("training")
    env = _module("gymnasium").make("dsl_assembly/PegInHole-v0")
    return _gymnasium(env, _ours(env.unwrapped.contract, 1), (_module("mujoco.batch").Batch, "step"))


def many_cells() -> Environment:
    """Return this project's vectorised Gymnasium environment, with its physics on one thread."""
    _module("training")
    kind = "vector_entry_point"
    env = _module("gymnasium").make_vec("dsl_assembly/PegInHole-v0", num_envs=CELLS, vectorization_mode=kind)
    own_reset = (_module("training.environment.insertion").Insertions, "reset")
    return _gymnasium(env, _ours(env.contract, CELLS), (_module("mujoco.batch").Batch, "step"), own_reset)


def fetch_pick_and_place() -> Environment:
    """Return Gymnasium-Robotics' arm, whose hand is pulled along by the simulator (a mocap weld)."""
    _module("gymnasium").register_envs(_module("gymnasium_robotics"))
    env = _module("gymnasium").make("FetchPickAndPlace-v4")
    plain = env.unwrapped
    taken = Taken(1, plain.dt, plain.model.opt.timestep, _versions("gymnasium-robotics", "mujoco"))
    return _gymnasium(env, taken, (_module("mujoco"), "mj_step"))


def nut_assembly() -> Environment:
    """Return robosuite's task in which one arm puts a nut on a peg."""
    return _robosuite("NutAssemblySquare", "UR5e")


def two_arm_peg_in_hole() -> Environment:
    """Return robosuite's task of two arms, a peg in one and the hole in the other."""
    return _robosuite("TwoArmPegInHole", ["Panda", "Panda"])


ENVIRONMENTS: dict[str, Callable[[], Environment]] = {
    make.__name__: make for make in (one_cell, many_cells, fetch_pick_and_place, nut_assembly, two_arm_peg_in_hole)
}


def stepped(environment: Environment, seconds: float) -> Taken:
    """Step with random actions for `seconds` of wall-clock, resets excluded, after a warm-up."""
    taken, rng = environment.taken, np.random.default_rng(0)
    with ExitStack() as stack:
        physics = [stack.enter_context(timed(*function)) for function in environment.physics]
        own = [stack.enter_context(timed(*environment.own_reset))] if environment.own_reset else []
        for number in range(1 if own else RESETS):
            spent_s = _spent(environment.reset)
            if number:
                taken.resets += 1
                taken.resets_s += spent_s
        number = 0
        while taken.stepping_s < seconds:
            action = rng.uniform(environment.low, environment.high).astype(environment.low.dtype)
            for watch in (*physics, *own):
                watch.calls.clear()
            begin = time.perf_counter()
            ended = environment.step(action)
            step_s = time.perf_counter() - begin
            physics_s, reset_s = sum(watch.spent_s for watch in physics), sum(watch.spent_s for watch in own)
            step_s -= reset_s
            if ended and not own:
                reset_s = _spent(environment.reset)
            number += 1
            if number > WARM_UP:
                taken.steps += taken.cells
                taken.stepping_s += step_s
                taken.physics_s += physics_s
                taken.resets += ended
                taken.resets_s += reset_s
    return taken


def _gymnasium(
    env: Any, taken: Taken, physics: tuple[Any, str], own_reset: tuple[Any, str] | None = None
) -> Environment:
    def step(action: npt.NDArray[Any]) -> int:
        _, _, terminated, truncated, _ = env.step(action)
        return int(np.sum(np.logical_or(terminated, truncated)))

    space = env.action_space
    return Environment(space.low, space.high, env.reset, step, (physics,), own_reset, taken)


def _robosuite(name: str, robots: str | list[str]) -> Environment:
    """Return a task of robosuite under its operational-space controller, without pictures."""
    suite, mujoco = _module("robosuite"), _module("mujoco")
    env = suite.make(
        name,
        robots=robots,
        controller_configs=_module("robosuite.controllers").load_composite_controller_config(controller="BASIC"),
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
        hard_reset=False,  # the model is kept from episode to episode, as in this project
    )
    low, high = env.action_spec

    def step(action: npt.NDArray[Any]) -> int:
        return int(env.step(action)[2])

    physics = tuple((mujoco, function) for function in ("mj_step", "mj_step1", "mj_step2"))
    taken = Taken(1, env.control_timestep, env.model_timestep, _versions("robosuite", "mujoco"))
    return Environment(low, high, env.reset, step, physics, None, taken)


def _ours(contract: Any, cells: int) -> Taken:
    return Taken(cells, contract.period_s, contract.period_s / contract.ticks_per_step, _versions("mujoco"))


def _module(name: str) -> Any:
    """Import a module that only some Pythons have."""
    return importlib.import_module(name)


def _versions(*packages: str) -> str:
    return ", ".join(f"{package} {version(package)}" for package in packages)


def _spent(call: Callable[[], object]) -> float:
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def main(name: str, seconds: str) -> None:
    """Print the fields of `Taken`, or the `missing` module."""
    try:
        environment = ENVIRONMENTS[name]()
    except ModuleNotFoundError as error:
        print(json.dumps({"missing": error.name}))
        return
    print(json.dumps(asdict(stepped(environment, float(seconds)))))


if __name__ == "__main__":
    main(*sys.argv[1:])
