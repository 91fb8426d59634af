"""Gymnasium environments of the insertion: `PegInHoleEnv` for one cell, `PegInHoleVectorEnv` for many.

Both are thin wrappers: `training.environment.insertion.Insertions` does all the work. `docs/reference/environment.md`
is the user's page.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from service.policy.contract import PolicyContract
from service.policy.observation import ObservationMode
from training.environment import design
from training.environment.episodes import TaskSource
from training.environment.insertion import Insertions, Outcome, info_of
from training.environment.reward import RewardName
from wire.arrays import BoolArray, Float32Array, FloatArray
from wire.limits import FORCE_CEILING_N, FORCE_HARD_MAXIMUM_N
from wire.modes import LockMode
from wire.task import Conditions, Part, Task

if TYPE_CHECKING:
    from sim_backend.world.rendering import Renderer

Observation = Float32Array
Picture = npt.NDArray[np.uint8]

OPTIONS = ("clearance_m", "world_seed")
PICTURE_SIZE = (480, 360)
"""Width and height of a rendered frame, pixels."""
_LARGEST = {"m": 2.0, "rad": 6.3, "m,rad": 6.3, "N": 200.0, "N·m": 100.0, "1": 4.0}
"""Bounds of an observation by unit of the entry, beyond the arm's reach, its joints' range and its sensor's range."""


class Settings(TypedDict, total=False):
    """Keyword arguments of both environments.

    Attributes:
        mode: observed quantities. VFTM (default): the hole's estimate and the contact; FTM: the nominal centre and the
            contact; VM: the estimate alone.
        lock: `paper` (default), `sliding` or `off`. Mode VM allows only `off`, which is its default.
        part: peg and hole; default `tr`.
        clearance_m: clearance per face, m; one value (default 2 mm) or a range to draw from.
        reward: `potential` (default) or `paper`.
        conditions: name of the conditions of an episode; default `standard`. FTM needs `search` or `easy`.
        randomise_plant: True: friction, stiffness, delay and mass vary too; default False.
        force_ceiling_n: resultant force at which an episode ends in a fault, N; default 30.
        threads: number of threads that step the physics; default 1, 0 for one per core.
        max_episode_steps: length of an episode, steps; default 110.
    """

    mode: ObservationMode
    lock: LockMode | None
    part: Part
    clearance_m: float | tuple[float, float]
    reward: RewardName
    conditions: Conditions
    randomise_plant: bool
    force_ceiling_n: float
    threads: int
    max_episode_steps: int


class PegInHoleVectorEnv(gym.vector.VectorEnv[Observation, npt.NDArray[Any], npt.NDArray[Any]]):
    """Many cells in one natively vectorised environment.

    A cell that ends an episode begins the next one within the same step. The returned observation is then the new
    episode's first; `info["final_obs"]` and `info["final_info"]` hold the last of the old episode. Cell i with seed s
    plays the episodes of the single environment with seed s + i.

    Args:
        num_envs: number of cells.
        render_mode: None or `rgb_array`.
        settings: see `Settings`.

    Raises:
        ValueError: the settings contradict each other.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # Gymnasium's own declaration of it
        "render_modes": ["rgb_array"],
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(self, num_envs: int = 1, render_mode: str | None = None, **settings: Unpack[Settings]) -> None:
        self._cells = _Cells(num_envs, render_mode, settings)
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.metadata = self._cells.metadata(self.metadata)
        self.single_observation_space = self._cells.observation_space
        self.single_action_space = self._cells.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._generators: list[np.random.Generator] = []

    @property
    def contract(self) -> PolicyContract:
        """Contract that a policy trained here must carry to be deployed."""
        return self._cells.insertions.contract

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode in every cell.

        Args:
            seed: seed of cell 0, from which the other cells count up; or a list with one seed for each cell.
            options: settings of these episodes only: `clearance_m`, and `world_seed`, which fixes the world of cell 0
                and counts up for the other cells.

        Returns:
            (n, size) observations, and an info with `world_seed` and `clearance_m` (n,) of the episodes.

        Raises:
            ValueError: an unknown option, or a value that no world can be built from.
        """
        super().reset(seed=seed if isinstance(seed, int) else None)
        seeds: Sequence[int | None]
        if isinstance(seed, list):
            if len(seed) != self.num_envs:
                raise ValueError(f"seed has {len(seed)} values for {self.num_envs} environments")
            seeds = seed
        elif seed is not None:
            seeds = [seed + cell for cell in range(self.num_envs)]
        elif self._generators:
            seeds = [None] * self.num_envs
        else:
            seeds = self.np_random.integers(2**31, size=self.num_envs).tolist()
        generators = self._generators or [self.np_random] * self.num_envs
        self._generators = [
            old if own is None else seeding.np_random(own)[0] for old, own in zip(generators, seeds, strict=True)
        ]
        tasks = [self._cells.draw(rng, options, cell) for cell, rng in enumerate(self._generators)]
        everyone = np.arange(self.num_envs)
        observation = self._cells.insertions.reset(everyone, tasks).copy()
        return observation, self._masked(self._laid_out(everyone, tasks), np.ones(self.num_envs, np.bool_))

    def step(self, actions: npt.NDArray[Any]) -> tuple[Observation, FloatArray, BoolArray, BoolArray, dict[str, Any]]:
        """Run one policy step of every cell.

        Args:
            actions: (n, k) in [-1, 1].

        Returns:
            Observations (n, size), rewards, terminations, truncations (n,), and infos, each key with a mask `_key`.

        Raises:
            ValueError: an action of another shape, or one that is not finite.
            gymnasium.error.ResetNeeded: `reset` was not called yet.
        """
        if not self._generators:
            raise gym.error.ResetNeeded("call reset before the first step")
        outcome = self._cells.step(actions)
        observation = outcome.observation.copy()
        done = outcome.terminated | outcome.truncated
        infos = self._masked(info_of(outcome), ~done)
        ended = np.flatnonzero(done)
        if ended.size:
            last = np.full(self.num_envs, None, object)
            for cell in ended:
                last[cell] = outcome.observation[cell].copy()
            infos |= self._masked({"final_obs": last, "final_info": self._masked(info_of(outcome), done)}, done)
            tasks = [self._cells.draw(self._generators[cell], None, 0) for cell in ended]
            observation[ended] = self._cells.insertions.reset(ended, tasks)[ended]
            infos |= self._masked(self._laid_out(ended, tasks), done)
        return observation, outcome.reward, outcome.terminated, outcome.truncated, infos

    def render(self) -> tuple[Picture, ...] | None:
        """Draw every cell.

        Raises:
            RenderingUnavailableError: this machine cannot draw; the text says what to install.
        """
        if self.render_mode is None:
            return None
        return tuple(self._cells.draw_picture(cell) for cell in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        self._cells.close()

    def _laid_out(self, cells: npt.NDArray[np.int64], tasks: Sequence[Task]) -> dict[str, npt.NDArray[Any]]:
        seeds, clearances = np.zeros(self.num_envs, np.int64), np.zeros(self.num_envs)
        seeds[cells], clearances[cells] = [t.seed for t in tasks], [t.clearance_m for t in tasks]
        return {"world_seed": seeds, "clearance_m": clearances}

    def _masked(self, values: dict[str, Any], mask: BoolArray) -> dict[str, Any]:
        return values | {f"_{key}": mask.copy() for key in values}


class PegInHoleEnv(gym.Env[Observation, npt.NDArray[Any]]):
    """One cell; registered as `dsl_assembly/PegInHole-v0`.

    Args:
        render_mode: None or `rgb_array`.
        settings: see `Settings`.

    Raises:
        ValueError: the settings contradict each other.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012  # as above

    def __init__(self, render_mode: str | None = None, **settings: Unpack[Settings]) -> None:
        self._cells = _Cells(1, render_mode, settings)
        self.render_mode = render_mode
        self.metadata = self._cells.metadata(self.metadata)
        self.observation_space = self._cells.observation_space
        self.action_space = self._cells.action_space
        self._under_way = False

    @property
    def contract(self) -> PolicyContract:
        """Contract that a policy trained here must carry to be deployed."""
        return self._cells.insertions.contract

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: seed of `np_random`, from which every episode's world is drawn.
            options: settings of this episode only: `clearance_m`, m, and `world_seed`, which fixes its world.

        Returns:
            (size,) observation, and an info with the episode's `world_seed` and `clearance_m`.

        Raises:
            ValueError: an unknown option, or a value that no world can be built from.
        """
        super().reset(seed=seed)
        task = self._cells.draw(self.np_random, options, 0)
        observation = self._cells.insertions.reset(np.arange(1), [task])
        self._under_way = True
        return observation[0].copy(), {"world_seed": task.seed, "clearance_m": task.clearance_m}

    def step(self, action: npt.NDArray[Any]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Run one policy step; `action` (k,) in [-1, 1].

        Raises:
            ValueError: an action of another shape, or one that is not finite.
            gymnasium.error.ResetNeeded: no episode is under way: before the first reset or after an episode's end.
        """
        if not self._under_way:
            raise gym.error.ResetNeeded("no episode is under way: call reset first")
        outcome = self._cells.step(np.asarray(action)[None])
        terminated, truncated = bool(outcome.terminated[0]), bool(outcome.truncated[0])
        self._under_way = not (terminated or truncated)
        info = {key: value[0].item() for key, value in info_of(outcome).items()}
        return outcome.observation[0].copy(), float(outcome.reward[0]), terminated, truncated, info

    def render(self) -> Picture | None:  # pyright: ignore[reportIncompatibleMethodOverride]  # one frame, not a list
        """Draw the cell: (height, width, 3) uint8.

        Raises:
            RenderingUnavailableError: this machine cannot draw; the text says what to install.
        """
        return None if self.render_mode is None else self._cells.draw_picture(0)

    def close(self) -> None:
        """Free the renderer; may be called again."""
        self._cells.close()


class _Cells:
    """Common part of both environments: the insertions, their spaces, the draw of episodes and the pictures."""

    def __init__(self, n: int, render_mode: str | None, settings: Settings) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode must be None or 'rgb_array', not {render_mode!r}")
        unknown = set(settings) - set(Settings.__annotations__)
        if unknown:
            known = ", ".join(Settings.__annotations__)
            raise TypeError(f"unknown setting {', '.join(sorted(unknown))}; known are {known}")
        mode, part = settings.get("mode", "VFTM"), settings.get("part", "tr")
        conditions = settings.get("conditions", "standard")
        design.check_conditions(mode, conditions)
        ceiling = settings.get("force_ceiling_n", FORCE_CEILING_N)
        if not 0 < ceiling <= FORCE_HARD_MAXIMUM_N:
            raise ValueError(f"force_ceiling_n must be above 0 and at most {FORCE_HARD_MAXIMUM_N:g} N, not {ceiling!r}")
        clearance = settings.get("clearance_m", 2.0e-3)
        span = clearance if isinstance(clearance, tuple) else (clearance, clearance)
        for value in span:
            Task(0, part, value, conditions, settings.get("randomise_plant", False)).check()
        contract = design.contract_for(
            mode,
            settings.get("lock"),
            part,
            clearance_m=span,
            max_steps=settings.get("max_episode_steps", design.MAX_STEPS),
        )
        self._source = TaskSource(part, span, conditions, settings.get("randomise_plant", False))
        self.insertions = Insertions(
            contract, n, part, settings.get("threads", 1), ceiling, settings.get("reward", "potential")
        )
        bound = np.concatenate(
            [np.full(entry.size * entry.history, _LARGEST[entry.unit], np.float32) for entry in contract.observation]
        )
        self.observation_space = gym.spaces.Box(-bound, bound, dtype=np.float32)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (self.insertions.action_size,), np.float32)
        self._renderer: tuple[float, Renderer] | None = None

    def metadata(self, declared: dict[str, Any]) -> dict[str, Any]:
        """Return the class's metadata with the frame rate at which a played-back episode runs in real time."""
        return declared | {"render_fps": round(1.0 / self.insertions.contract.period_s)}

    def draw(self, rng: np.random.Generator, options: dict[str, Any] | None, cell: int) -> Task:
        """Draw an episode; `options` override the drawn values."""
        task = self._source.draw(rng, 1)[0]
        options = options or {}
        unknown = set(options) - set(OPTIONS)
        if unknown:
            raise ValueError(f"unknown reset option {', '.join(sorted(unknown))}; known are {', '.join(OPTIONS)}")
        if "clearance_m" in options:
            task = replace(task, clearance_m=float(options["clearance_m"]))
        if "world_seed" in options:
            task = replace(task, seed=int(options["world_seed"]) + cell)
        task.check()
        return task

    def step(self, action: npt.NDArray[Any]) -> Outcome:
        """Check the action and step every cell."""
        want = (self.insertions.n, self.insertions.action_size)
        if action.shape != want or not np.isfinite(action).all():
            raise ValueError(f"want finite actions of shape {want}, got shape {action.shape}: {action}")
        return self.insertions.step(action)

    def draw_picture(self, cell: int) -> Picture:
        """Draw one cell."""
        from sim_backend.world.rendering import Renderer  # only rendering needs OpenGL

        world = self.insertions.world
        clearance = float(world.clearance[cell])
        if self._renderer is None or self._renderer[0] != clearance:
            self.close()
            self._renderer = clearance, Renderer(world.part, clearance, *PICTURE_SIZE)
        return self._renderer[1].draw(world.model(cell), world.data(cell))

    def close(self) -> None:
        renderer, self._renderer = self._renderer, None
        if renderer is not None:
            renderer[1].close()
