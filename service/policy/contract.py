"""The policy contract: JSON in the metadata of an ONNX model that states what the policy needs.

`docs/reference/policy-contract.md` is the reference for integrators.
"""

from collections import Counter
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self, cast

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError, model_validator

from service.policy.action import COMPONENTS, ActionMap
from service.policy.observation import ENTRIES, Frame, Need, ObservationBuilder, ObservationMode
from service.safety.dsl import DslParameters
from wire.law import ComplianceLaw
from wire.limits import LockMode

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


@dataclass(frozen=True, slots=True)
class CellCapabilities:
    """What a cell offers a policy.

    Attributes:
        tick_s: period of its control law, s.
        part: that it assembles.
        clearance_m: per face, if known.
        camera: it has an estimate of the hole's position.
        force_torque: it has a force/torque sensor.
        last_joint: it reports joint angles.
        stiffness_max: largest stiffness that its law runs, N/m and N·m/rad.
        damping_min: least damping, N·s/m and N·m·s/rad.
        inertia_min: least inertia, kg and kg·m².
        locks: modes of the lock that it runs.
        press_max_m: farthest that the lock may press below the height of a contact, m.
    """

    tick_s: float
    part: str
    clearance_m: float | None
    camera: bool
    force_torque: bool
    last_joint: bool
    stiffness_max: tuple[float, float, float, float, float, float]
    damping_min: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    inertia_min: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    locks: tuple[LockMode, ...] = ("paper",)
    press_max_m: float = 5e-3


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
        provenance: how the policy was trained: anything that JSON can express.
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

    def check_against(self, cell: CellCapabilities) -> tuple[str, ...]:
        """Every reason for which `cell` cannot run this policy as it was trained; empty if it can."""
        reasons: list[str] = []
        if self.tick_s != cell.tick_s:
            reasons.append(
                f"the policy wants a tick of {self.tick_s * 1e3:g} ms, the cell has {cell.tick_s * 1e3:g} ms"
            )
        if cell.part not in self.parts:
            reasons.append(f"the policy is for {', '.join(self.parts)}, the cell assembles {cell.part}")
        low, high = self.clearance_m
        if cell.clearance_m is not None and not low <= cell.clearance_m <= high:
            reasons.append(
                f"the policy is for a clearance of {low * 1e3:g} to {high * 1e3:g} mm per face, "
                f"the cell has {cell.clearance_m * 1e3:g} mm"
            )
        offered = {
            Need.FORCE_TORQUE: (cell.force_torque, "a force/torque sensor"),
            Need.HOLE: (cell.camera or self.mode == "FTM", "a camera's estimate of the hole"),
            Need.LAST_JOINT: (cell.last_joint, "joint angles"),
        }
        for entry in self.observation:
            for need in sorted(ENTRIES[entry.name].needs):
                has, thing = offered[need]
                if not has:
                    reasons.append(f"observation entry {entry.name!r} needs {thing}, which the cell does not have")
        if self.dsl.mode != "off" and not cell.force_torque:
            reasons.append(f"the safety lock in mode {self.dsl.mode!r} needs a force/torque sensor")
        if self.dsl.mode not in cell.locks:
            reasons.append(
                f"the safety lock is in mode {self.dsl.mode!r}, this recipe runs {', '.join(cell.locks)}: "
                "allow_lock of the recipe says which"
            )
        if self.dsl.press_m > cell.press_max_m:
            reasons.append(
                f"dsl.press_m is {self.dsl.press_m * 1e3:g} mm, the cell presses at most {cell.press_max_m * 1e3:g} mm"
            )
        for name, wanted, least in (
            ("damping", self.compliance.damping, cell.damping_min),
            ("inertia", self.compliance.inertia, cell.inertia_min),
        ):
            for axis, (want, limit) in enumerate(zip(wanted, least, strict=True)):
                if want < limit:
                    reasons.append(f"compliance.{name}[{axis}] is {want:g}, the cell runs at least {limit:g}")
        for axis, (want, most) in enumerate(zip(self.compliance.stiffness, cell.stiffness_max, strict=True)):
            if want > most:
                reasons.append(f"compliance.stiffness[{axis}] is {want:g}, the cell runs at most {most:g}")
        return tuple(reasons)


def json_schema() -> dict[str, JsonValue]:
    """Return the JSON schema of the contract."""
    return PolicyContract.model_json_schema()
