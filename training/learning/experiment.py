"""An experiment: everything that decides the outcome of a training, as one TOML file in `training/experiments/`.

`docs/reference/experiment-file.md` explains how to write one.
"""

import math
import tomllib
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from service.policy.contract import PolicyContract
from service.policy.observation import ObservationMode
from service.safety.contact_loop import why_not_law
from training.environment import design
from training.environment.reward import FORCE_COST_PER_N, RewardName
from wire.law import ComplianceLaw
from wire.limits import FORCE_CEILING_N, FORCE_HARD_MAXIMUM_N
from wire.modes import LockMode
from wire.task import Conditions, Part, Task

FOLDER = Path(__file__).parents[1] / "experiments"

Count = Annotated[int, Field(ge=1)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]


class ExperimentError(ValueError):
    """An experiment cannot be found, read or run; the text names every field at fault."""


class ExperimentSection(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class TaskSection(ExperimentSection):
    """The task: what the training plays.

    Attributes:
        mode: observation mode. VFTM: the hole's estimate and the contact; FTM: the nominal centre and the contact;
            VM: the estimate alone.
        lock: how the depth is limited: `paper`, `sliding` or `off`, the only one that VM has.
        parts: pegs and holes; each gets the same number of workers.
        clearance_mm: range of clearances per face to draw from; tight ones are drawn more often.
        conditions: distributions of an episode, see `docs/reference/conditions.md`.
        randomise_plant: friction, stiffness, delay and mass vary.
        slips: share of the training episodes in which the hole slips once to another place and yaw.
        misreads: share of the training episodes in which the torque about z is scaled by a factor within ±1.
        reward: name of a reward in `training.environment.reward`.
        force_cost_per_n: cost per newton of peak force above 12 N, in the reward `potential`.
        max_steps: largest number of steps of an episode.
        force_ceiling_n: resultant that ends an episode in a fault.
    """

    mode: ObservationMode = "VFTM"
    lock: LockMode = "paper"
    parts: Annotated[tuple[Part, ...], Field(min_length=1)] = ("tr",)
    clearance_mm: tuple[Positive, Positive]
    conditions: Conditions = "standard"
    randomise_plant: bool = True
    slips: Share = 0.0
    misreads: Share = 0.0
    reward: RewardName = "potential"
    force_cost_per_n: NotNegative = FORCE_COST_PER_N
    max_steps: Count = design.MAX_STEPS
    force_ceiling_n: Annotated[float, Field(gt=0, le=FORCE_HARD_MAXIMUM_N)] = FORCE_CEILING_N

    @property
    def clearance_m(self) -> tuple[float, float]:
        """`clearance_mm` in m."""
        return self.clearance_mm[0] * 1e-3, self.clearance_mm[1] * 1e-3

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.clearance_mm[0] > self.clearance_mm[1]:
            raise ValueError(f"clearance_mm runs from {self.clearance_mm[0]} down to {self.clearance_mm[1]}")
        if len(set(self.parts)) < len(self.parts):
            raise ValueError("parts names one more than once")
        for clearance in self.clearance_m:
            Task(0, self.parts[0], clearance, self.conditions, self.randomise_plant).check()
        design.check_conditions(self.mode, self.conditions)
        return self


class PolicySection(ExperimentSection):
    """Changes to the policy's contract; None: as `training.environment.design` makes it.

    Attributes:
        press_mm: largest distance of a command below the lock.
        dxy_mm: displacement per step in x and in y at an action of ±1.
        dz_mm: displacement per step in z at an action of ±1.
        dyaw_deg: turn per step at an action of ±1.
        wrench_window_ticks: number of newest samples of a step that are averaged.
    """

    press_mm: NotNegative | None = None
    dxy_mm: Positive | None = None
    dz_mm: Positive | None = None
    dyaw_deg: Positive | None = None
    wrench_window_ticks: Count | None = None

    def adjust(self, contract: PolicyContract) -> PolicyContract:
        """Return `contract` with the changes of this section."""
        scaled = {
            "dx": (self.dxy_mm, 1e-3),
            "dy": (self.dxy_mm, 1e-3),
            "dz": (self.dz_mm, 1e-3),
            "dyaw": (self.dyaw_deg, math.pi / 180),
        }
        return design.adjusted(
            contract,
            press_m=None if self.press_mm is None else self.press_mm * 1e-3,
            limits={name: value * unit for name, (value, unit) in scaled.items() if value is not None},
            wrench_window_ticks=self.wrench_window_ticks,
        )


class AdmittedSection(ExperimentSection):
    """Use that the policy is admitted for, if it differs from its training; a cell refuses any other use.

    Attributes:
        parts: pegs and holes; empty: those of the task.
        clearance_mm: least and largest clearance per face; None: the task's.
    """

    parts: tuple[Part, ...] = ()
    clearance_mm: tuple[Positive, Positive] | None = None


class AlgorithmSection(ExperimentSection):
    """PPO: network, sizes and rates.

    Attributes:
        memory: `gru`: a recurrent unit, one frame of observation; `none`: none, the last 4 to 12 frames instead.
        width: width of the encoder.
        hidden: width of the recurrent unit, or of the layer in its place.
        steps: environment steps in all.
        cells: simulated cells stepped together, over all workers.
        workers: processes that the cells are spread over; a multiple of the number of parts.
        rollout: steps per cell between two updates; gradients reach back as far.
        learning_rate: Adam's rate at the start; it falls linearly to a tenth.
        epochs: passes over a rollout.
        minibatches: minibatches per pass; each holds whole sequences of some cells.
        gamma: discount of the return.
        gae_lambda: lambda of the advantages (Schulman et al., 2016).
        averaging: share of the old weights in the running average at each update; the average is evaluated and
            exported; 0: the latest weights.
        entropy: weight of the bonus for exploration.
        auxiliary_weight: weight of the error of the head that locates the hole.
        initial_log_std: logarithm of the exploration's deviation at the start; with `start_from` its lower limit.
    """

    memory: Literal["gru", "none"] = "gru"
    width: Count = 128
    hidden: Count = 128
    steps: Count
    cells: Count = 192
    workers: Count = 2
    rollout: Count = 64
    learning_rate: Positive = 5e-4
    epochs: Count = 4
    minibatches: Count = 4
    gamma: Share = 0.99
    gae_lambda: Share = 0.95
    averaging: Annotated[float, Field(ge=0, lt=1)] = 0.0
    entropy: NotNegative = 1e-3
    auxiliary_weight: NotNegative = 0.5
    initial_log_std: float = -0.7

    @model_validator(mode="after")
    def _divides(self) -> Self:
        if self.cells % self.workers:
            raise ValueError(f"{self.cells} cells do not divide evenly over {self.workers} workers")
        if self.minibatches > self.cells:
            raise ValueError(f"{self.minibatches} minibatches are more than {self.cells} cells")
        return self


class EvaluationSection(ExperimentSection):
    """Evaluations during the training: deterministic policy, nominal plant, the validation's seeds.

    Attributes:
        every_steps: environment steps between two evaluations; one more follows at the end.
        episodes: number per part and clearance, the same ones every time.
        clearances_mm: clearances per face.
        conditions: distributions of an episode; None: those of the task.
    """

    every_steps: Count
    episodes: Annotated[int, Field(ge=1, le=10_000)] = 100
    clearances_mm: Annotated[tuple[Positive, ...], Field(min_length=1)]
    conditions: Conditions | None = None


class Experiment(ExperimentSection):
    """One experiment, trained once for each of its seeds.

    Attributes:
        name: name of the file that it was read from.
        title: description in one line.
        task: what the training plays.
        law: compliance law about the TCP: `stiffness`, `damping`, `inertia` of six numbers each.
        policy: changes to the policy's contract.
        admitted: use that the policy is admitted for.
        algorithm: algorithm, network and sizes.
        evaluation: evaluations during the training.
        seeds: seeds of network, exploration and tasks; one training each.
        start_from: name of the experiment whose best model of the same seed this one begins with; None: none.
    """

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9.-]*$", max_length=60)]
    title: Annotated[str, Field(min_length=1)]
    task: TaskSection
    law: ComplianceLaw = design.LAW
    policy: PolicySection = PolicySection()
    admitted: AdmittedSection = AdmittedSection()
    algorithm: AlgorithmSection
    evaluation: EvaluationSection
    seeds: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1)] = (0,)
    start_from: str | None = None

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.algorithm.workers % len(self.task.parts):
            raise ValueError(
                f"algorithm.workers is {self.algorithm.workers}, which does not divide evenly over "
                f"{len(self.task.parts)} parts"
            )
        for clearance in self.evaluation.clearances_mm:
            Task(0, self.task.parts[0], clearance * 1e-3).check()
        design.check_conditions(self.task.mode, self.evaluation.conditions or self.task.conditions)
        self.contract()
        if reasons := tuple(why_not_law(self.law)):
            raise ValueError(f"law: {'; '.join(reasons)}")
        return self

    def contract(self) -> PolicyContract:
        """Return the contract of the policy that this experiment trains."""
        low, high = self.admitted.clearance_mm or self.task.clearance_mm
        contract = design.contract_for(
            self.task.mode,
            self.task.lock,
            self.admitted.parts or self.task.parts,
            clearance_m=(low * 1e-3, high * 1e-3),
            max_steps=self.task.max_steps,
            name=self.name,
            law=self.law,
            hidden_size=self.algorithm.hidden if self.algorithm.memory == "gru" else 0,
        )
        return self.policy.adjust(contract)


def names() -> list[str]:
    """Return the names of all experiments that come with the project."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def load(name: str) -> Experiment:
    """Read an experiment.

    Args:
        name: name of an experiment in `training/experiments/`, or the path of a file that ends in `.toml`.

    Raises:
        ExperimentError: there is none of that name, or its settings are impossible.
    """
    path = Path(name) if name.endswith(".toml") else FOLDER / f"{name}.toml"
    try:
        document = tomllib.loads(path.read_text())
    except FileNotFoundError as error:
        raise ExperimentError(f"there is no experiment {name!r}; there are {', '.join(names())}") from error
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ExperimentError(f"cannot read {path}: {error}") from error
    try:
        return Experiment.model_validate({"name": path.stem, **document})
    except ValidationError as error:
        faults = [f"{'.'.join(map(str, fault['loc'])) or 'experiment'}: {fault['msg']}" for fault in error.errors()]
        raise ExperimentError(f"{path}: {'; '.join(faults)}") from error
