"""The training of a policy, told from its contract's provenance: in words if `export` wrote it, else as it stands."""

from collections.abc import Iterator, Mapping

from pydantic import BaseModel, ConfigDict, JsonValue, ValidationError

from training.report.document import Paragraph, ReportBlock, Table
from training.report.measured import commit_name, duration, percent


class AccountSection(BaseModel):
    """The fields of an account that are read; any other field is ignored."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class TrainedTask(AccountSection):
    parts: tuple[str, ...]
    clearance_mm: tuple[float, float]
    conditions: str
    randomise_plant: bool
    reward: str
    force_ceiling_n: float


class TrainedAlgorithm(AccountSection):
    memory: str
    steps: int
    cells: int


class TrainedExperiment(AccountSection):
    name: str
    title: str
    task: TrainedTask
    algorithm: TrainedAlgorithm
    start_from: str | None = None


class Beginning(AccountSection):
    """The weights that a training began with.

    Attributes:
        file: name of the file that held them.
        experiment: experiment that trained them; None: not known.
        steps: environment steps of that training; None: not known.
    """

    file: str
    experiment: str | None = None
    steps: int | None = None


class TrainingSession(AccountSection):
    steps: int
    began: str
    commit: str | None
    machine: str
    began_with: Beginning | None = None


class ValidationRate(AccountSection):
    part: str
    clearance_m: float
    conditions: str
    episodes: int
    successes: int


class Account(AccountSection):
    """The provenance that `dsl-assembly export` writes into a contract.

    Attributes:
        experiment: experiment that was trained.
        seed: seed of network, exploration and tasks.
        sessions: sessions of the training.
        steps: environment steps after which these weights were kept.
        elapsed_s: host time until then; None: not known.
        validation: rates for which they were kept; empty: not known.
    """

    experiment: TrainedExperiment
    seed: int
    sessions: tuple[TrainingSession, ...]
    steps: int
    elapsed_s: float | None = None
    validation: tuple[ValidationRate, ...] = ()

    @property
    def began_with(self) -> str | None:
        """Experiment or file whose weights the training began with, as Markdown; None: with none."""
        noted = self.sessions[0].began_with if self.sessions else None
        if noted is None:
            return f"`{self.experiment.start_from}`" if self.experiment.start_from else None
        after = "" if noted.steps is None else f" at {noted.steps / 1e6:.2f} M steps"
        return f"`{noted.experiment or noted.file}`{after}"


def account(provenance: Mapping[str, JsonValue]) -> Account | None:
    """Read a provenance; None where something else wrote it."""
    try:
        return Account.model_validate(provenance)
    except ValidationError:
        return None


def told(provenance: Mapping[str, JsonValue]) -> Iterator[ReportBlock]:
    """Say how a policy was trained."""
    known = account(provenance)
    if known is not None:
        yield from _in_words(known)
    elif provenance:
        yield Table(["provenance in the file", ""], [[f"`{name}`", text] for name, text in _flat(provenance)])
    else:
        yield Paragraph("The file does not say.")


def _in_words(known: Account) -> Iterator[ReportBlock]:
    experiment, task = known.experiment, known.experiment.task
    low, high = task.clearance_mm
    began = f", begun with weights of {known.began_with}" if known.began_with else ""
    spent = "" if known.elapsed_s is None else f" and {duration(known.elapsed_s)}"
    plant = "randomised" if task.randomise_plant else "nominal"
    yield Paragraph(
        f"Experiment `{experiment.name}` ({_escaped(experiment.title)}), seed {known.seed}{began}. "
        f"Trained on {', '.join(task.parts)} at {low:g} to {high:g} mm per face, in the conditions "
        f"`{task.conditions}`, on a {plant} plant. The reward is `{task.reward}`, the force ceiling "
        f"{task.force_ceiling_n:g} N, the memory `{experiment.algorithm.memory}`; {experiment.algorithm.cells} cells "
        f"ran together. The weights are those after {known.steps / 1e6:.2f} of "
        f"{experiment.algorithm.steps / 1e6:.2f} million steps{spent} of that experiment."
    )
    if known.validation:
        rates = [
            f"{v.part} at {v.clearance_m * 1e3:.2f} mm, `{v.conditions}`: {percent(v.successes / v.episodes)} "
            f"of {v.episodes}"
            for v in known.validation
        ]
        yield Paragraph(
            "The weights were chosen by these rates, on other seeds than the tests'. The choice flatters the rates: "
            f"{'; '.join(rates)}."
        )
    yield Table(
        ["session from step", "began", "commit", "machine"],
        [
            [str(session.steps), session.began, f"`{commit_name(session.commit)}`", session.machine]
            for session in known.sessions
        ],
    )


def _flat(values: Mapping[str, JsonValue], path: str = "") -> Iterator[tuple[str, str]]:
    """Yield every plain value by its path; the plain values of an inner object together."""
    plain = {name: _plain(value) for name, value in values.items() if not isinstance(value, dict)}
    if path and plain:
        yield path, ", ".join(f"{name} {text}" for name, text in plain.items())
    elif plain:
        yield from plain.items()
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{path}.{name}" if path else name)


def _plain(value: JsonValue) -> str:
    if isinstance(value, list):
        return f"({', '.join(map(_plain, value))})"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, bool):
        return str(value).lower()
    return "none" if value is None else _escaped(str(value))


def _escaped(text: str) -> str:
    """Escape text from a file so that it stays within its table cell."""
    return text.replace("|", "\\|").replace("\n", " ")
