"""The policy contract: JSON in the metadata of an ONNX model that states what the policy needs.

`docs/reference/policy-contract.md` is the reference for integrators.
"""

from collections import Counter
from typing import Annotated, Any, Literal, Self, cast

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError, model_validator

from service.policy.action import COMPONENTS, ActionMap
from service.policy.observation import ENTRIES, Frame, Need, ObservationBuilder, ObservationMode, uses_estimate
from service.safety.dsl import DslParameters
from wire.law import ComplianceLaw

METADATA_KEY = "dsl_assembly_contract"
"""Key of the contract in the model's metadata."""
SCHEMA_VERSION = 1

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=1)]
Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class ContractError(ValueError):
    """A contract cannot be read or contradicts itself; the text names every field at fault."""


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ObservationEntry(Section):
    """One entry of the observation, `size` times `history` numbers, oldest frame first.

    Attributes:
        name: key of `service.policy.observation.ENTRIES`. That table fixes size, unit and frame; the entry repeats them
            so that the file can be read without the code.
        scale: divisor that the graph applies, per component or one for all. It informs the reader only.
        clip: limit at which the graph cuts the scaled value; None: no limit. It informs the reader only.
        history: number of frames.
    """

    name: str
    unit: str
    frame: Frame
    size: Count
    scale: Positive | tuple[Positive, ...] = 1.0
    clip: Positive | None = None
    history: Annotated[int, Field(ge=1, le=64)] = 1

    @model_validator(mode="after")
    def _known(self) -> Self:
        spec = ENTRIES.get(self.name)
        if spec is None:
            raise ValueError(f"unknown observation entry {self.name!r}; known are {', '.join(sorted(ENTRIES))}")
        for field, mine, want in (
            ("size", self.size, spec.size),
            ("unit", self.unit, spec.unit),
            ("frame", self.frame, spec.frame),
        ):
            if mine != want:
                raise ValueError(f"entry {self.name!r} has {field} {want!r}, the contract says {mine!r}")
        if isinstance(self.scale, tuple) and len(self.scale) != self.size:
            raise ValueError(f"entry {self.name!r} has {self.size} components and {len(self.scale)} scales")
        return self

    @classmethod
    def of(
        cls, name: str, *, scale: float | tuple[float, ...] = 1.0, clip: float | None = None, history: int = 1
    ) -> Self:
        """Return entry `name` with its size, unit and frame.

        Raises:
            ValueError: there is no such entry.
        """
        spec = ENTRIES.get(name)
        if spec is None:
            raise ValueError(f"unknown observation entry {name!r}; known are {', '.join(sorted(ENTRIES))}")
        return cls(name=name, unit=spec.unit, frame=spec.frame, size=spec.size, scale=scale, clip=clip, history=history)


class ActionEntry(Section):
    """One component of the action, -1 … 1 in the network's output.

    Attributes:
        name: component of the displacement.
        unit: m, or rad for dyaw.
        frame: axes of dx and dy. `tool` is the base frame turned by the measured yaw; dz and dyaw are the same in both.
        limit: displacement at ±1, in `unit`.
        map: `linear`: a; `signed_square`: a·|a|, finer near zero.
    """

    name: Literal["dx", "dy", "dz", "dyaw"]
    unit: Literal["m", "rad"]
    frame: Literal["tool", "base"]
    limit: Positive
    map: Literal["linear", "signed_square"] = "linear"

    @model_validator(mode="after")
    def _unit_fits(self) -> Self:
        if (self.unit == "rad") != (self.name == "dyaw"):
            raise ValueError(f"action {self.name!r} cannot be in {self.unit}")
        return self


class EvaluationFigure(Section):
    """One measured result.

    Attributes:
        clearance_m: clearance per face, m.
        conditions: name of the conditions, see `docs/reference/conditions.md`.
        episodes: number of independent episodes of the deterministic policy, on seeds never trained on.
        successes: number of successful episodes.
        low: lower end of the 95 % Wilson interval of the success rate.
        high: upper end of that interval.
        peak_force_median_n: median over the episodes of the peak resultant force, taken over every sample, N.
        peak_force_max_n: largest of those peaks, N.
    """

    clearance_m: Positive
    conditions: str
    episodes: Count
    successes: Annotated[int, Field(ge=0)]
    low: Share
    high: Share
    peak_force_median_n: NotNegative | None = None
    peak_force_max_n: NotNegative | None = None


class PolicyContract(Section):
    """Everything that a cell must know to run a policy as it was trained.

    Attributes:
        schema_version: version of this document.
        name: name of the policy.
        parts: parts that the policy may be used for.
        clearance_m: least and largest clearance per face that the policy may be used at, m.
        mode: observed quantities. VFTM: hole and contact; FTM: contact; VM: hole.
        tick_s: period of the control law, s.
        ticks_per_step: ticks between two actions.
        max_steps: length of an episode, steps.
        observation: observation entries in order.
        action: action entries in order.
        dsl: constants of the safety lock.
        compliance: compliance law around the target.
        wrench_window_ticks: number of newest samples of a step that are averaged.
        hidden_size: size of the recurrent state; 0: none.
        provenance: record of the training: anything that JSON can express.
        evaluation: measured results.
    """

    schema_version: Literal[1] = SCHEMA_VERSION
    name: Annotated[str, Field(min_length=1, max_length=100)]
    parts: Annotated[tuple[str, ...], Field(min_length=1)]
    clearance_m: tuple[Positive, Positive]
    mode: ObservationMode
    tick_s: Positive = 0.002
    ticks_per_step: Annotated[int, Field(ge=1, le=500)]
    max_steps: Annotated[int, Field(ge=1, le=10_000)]
    observation: Annotated[tuple[ObservationEntry, ...], Field(min_length=1)]
    action: Annotated[tuple[ActionEntry, ...], Field(min_length=1)]
    dsl: DslParameters
    compliance: ComplianceLaw
    wrench_window_ticks: Annotated[int, Field(ge=1, le=500)]
    hidden_size: Annotated[int, Field(ge=0, le=4096)] = 0
    provenance: dict[str, JsonValue] = {}
    evaluation: tuple[EvaluationFigure, ...] = ()

    @model_validator(mode="before")
    @classmethod
    def _without_peck(cls, document: Any) -> Any:
        """Drop `dsl.peck_deeper_m`, an unused constant that policies exported before 0.2 carry."""
        if not isinstance(document, dict):
            return document
        fields = cast(dict[str, Any], document)
        if not isinstance(fields.get("dsl"), dict):
            return fields
        lock = cast(dict[str, Any], fields["dsl"])
        return {**fields, "dsl": {name: value for name, value in lock.items() if name != "peck_deeper_m"}}

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for what, names in (
            ("observation", [entry.name for entry in self.observation]),
            ("action", [entry.name for entry in self.action]),
        ):
            twice = [name for name, count in Counter(names).items() if count > 1]
            if twice:
                raise ValueError(f"{what} names {', '.join(twice)} more than once")
        if self.clearance_m[0] > self.clearance_m[1]:
            raise ValueError(
                f"clearance_m must be [least, largest], not [{self.clearance_m[0]}, {self.clearance_m[1]}]"
            )
        if self.wrench_window_ticks > self.ticks_per_step:
            raise ValueError(
                f"wrench_window_ticks is {self.wrench_window_ticks}, a step has {self.ticks_per_step} ticks"
            )
        if len({entry.frame for entry in self.action if entry.name in ("dx", "dy")}) > 1:
            raise ValueError("action dx and dy must be in the same frame")
        self._check_action_names()
        if self.mode == "VM":
            felt = [entry.name for entry in self.observation if Need.FORCE_TORQUE in ENTRIES[entry.name].needs]
            if felt:
                raise ValueError(f"mode VM observes no force or torque, but {', '.join(felt)} need it")
            if self.dsl.mode != "off":
                raise ValueError(f"mode VM bypasses the lock: dsl.mode must be 'off', not {self.dsl.mode!r}")
        return self

    def _check_action_names(self) -> None:
        names = {entry.name for entry in self.action}
        missing = [name for name in COMPONENTS if name not in names]
        if missing:
            raise ValueError(f"action lacks {', '.join(missing)}")

    @classmethod
    def from_json(cls, text: str | bytes) -> Self:
        """Read a contract.

        Raises:
            ContractError: the contract is not valid; the text names every wrong field.
        """
        try:
            return cls.model_validate_json(text)
        except ValidationError as error:
            lines = [
                f"{'.'.join(str(part) for part in fault['loc']) or 'contract'}: {fault['msg']}"
                for fault in error.errors()
            ]
            raise ContractError("; ".join(lines)) from error

    def to_json(self) -> str:
        """Return the contract as the JSON that the model's metadata holds."""
        return self.model_dump_json()

    def to_metadata(self) -> dict[str, str]:
        """Return the entry to add to the model's `metadata_props`."""
        return {METADATA_KEY: self.to_json()}

    @property
    def uses_estimate(self) -> bool:
        """True if approach, depth and observations use the camera's estimate of the hole."""
        return uses_estimate(self.mode)

    @property
    def period_s(self) -> float:
        """Time between two actions, s."""
        return self.tick_s * self.ticks_per_step

    @property
    def observation_size(self) -> int:
        """Length of the network's observation."""
        return sum(entry.size * entry.history for entry in self.observation)

    def observation_builder(self) -> ObservationBuilder:
        """Return the builder of this policy's observations."""
        return ObservationBuilder(
            self.observation,
            self.mode,
            self.max_steps,
            self.wrench_window_ticks,
            self.dsl.force_clip_n,
            self.dsl.torque_clip_nm,
        )

    def action_map(self) -> ActionMap:
        """Return the map from this policy's outputs to displacements."""
        return ActionMap(self.action)


def json_schema() -> dict[str, JsonValue]:
    """Return the JSON schema of the contract."""
    return PolicyContract.model_json_schema()
