"""The policy step twice, compiled and in numpy, their results side by side, and states to run them on."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from service.policy import compiled
from service.policy.compiled.policy_step import CompiledStep, policy_step
from service.policy.contract import ActionEntry, ObservationEntry, PolicyContract
from service.policy.model import Policy
from service.policy.observation import ENTRIES, Need, ObservationMode, ObservationState
from service.policy.step import PolicyStep, Seen, StepState
from service.safety.bounds import BoundsParameters
from service.safety.dsl import DslParameters, DslState
from wire.arrays import Float32Array, FloatArray
from wire.modes import LockMode

MODELS = Path(__file__).parents[4] / "models"
SHIPPED = {path.stem: Policy.load(path).contract for path in sorted(MODELS.glob("*.onnx"))}
MODES: tuple[LockMode, ...] = LockMode.__args__
LIMITS = BoundsParameters(
    period_s=0.1,
    step_m=8e-3,
    step_rad=0.1,
    speed_mps=0.07,
    speed_radps=1.1,
    leash_m=9e-3,
    leash_rad=0.12,
    workspace_lower=(0.3, -0.1, 0.0),
    workspace_upper=(0.5, 0.1, 0.4),
    yaw_centre_rad=3.0,
    yaw_half_range_rad=0.5,
    tilt_rad=0.1,
)
NO_RANGE = BoundsParameters(0.1, 8e-3, 0.1, 0.2, 0.5, 8e-3, 0.1, (-1.0, -1.0, -1.0), (1.0, 1.0, 1.0), -2.0, 4.0, 0.1)
ODD = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 1.0, -1.0, 1e6, -1e6, 1.1e6, 1e300, -1e300, 5e-324, 0.03, np.pi])
"""Numbers at which something changes, and some that no cell measures."""

needs_the_extension = pytest.mark.skipif(
    compiled.step is None, reason=f"the compiled step is not used, {compiled.absence}"
)


def contract(
    mode: ObservationMode = "VFTM", lock: DslParameters | None = None, *, entries: int = 18, first: int = 0
) -> PolicyContract:
    """Return a contract with `entries` kinds of entries from the `first` on, with histories, and an unusual action."""
    names = [name for name in ENTRIES if mode != "VM" or Need.FORCE_TORQUE not in ENTRIES[name].needs]
    chosen = (names[first:] + names[:first])[:entries]
    return PolicyContract(
        name="twin",
        parts=("tr",),
        clearance_m=(1e-4, 2e-3),
        mode=mode,
        ticks_per_step=6,
        max_steps=7,
        observation=tuple(ObservationEntry.of(name, history=1 + k % 3) for k, name in enumerate(chosen)),
        action=(
            ActionEntry(name="dyaw", unit="rad", frame="tool", limit=0.2, map="signed_square"),
            ActionEntry(name="dz", unit="m", frame="base", limit=0.004),
            ActionEntry(name="dx", unit="m", frame="tool" if first % 2 else "base", limit=0.01, map="signed_square"),
            ActionEntry(name="dy", unit="m", frame="tool" if first % 2 else "base", limit=0.02),
        ),
        dsl=DslParameters(mode="off") if mode == "VM" else lock or DslParameters(),
        compliance=SHIPPED["vftm-dsl"].compliance,
        wrench_window_ticks=4,
    )


def locks() -> list[DslParameters]:
    """Return locks of every mode, with and without the constants that are zero or None by default."""
    own = {"release_threshold": 0.2, "press_m": 1e-3, "search_steps": 3, "search_depth_m": 0.01, "lift_max_m": 1e-3}
    return [made for mode in MODES for made in (DslParameters(mode=mode), DslParameters(mode=mode, **own))]


def pair(made: PolicyContract, limits: BoundsParameters = LIMITS) -> tuple[CompiledStep, PolicyStep]:
    """Return the compiled step and that of numpy."""
    fast = policy_step(made, limits)
    assert isinstance(fast, CompiledStep)
    return fast, PolicyStep(made, limits)


def numbers(found: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every array within dataclasses and tuples, with its name."""
    if is_dataclass(found):
        for field in fields(found):
            yield from numbers(getattr(found, field.name), f"{name}.{field.name}")
    elif isinstance(found, tuple):
        for place, one in enumerate(found):
            yield from numbers(one, f"{name}[{place}]")
    else:
        yield name, np.asarray(found)


def assert_the_same(one: Any, other: Any) -> None:
    """Assert that two results have the same types, shapes and bits; every NaN is the same."""
    for (name, mine), (_, yours) in zip(numbers(one), numbers(other), strict=True):
        assert (mine.shape, mine.dtype) == (yours.shape, yours.dtype), name
        equal = np.array(mine == yours)
        if mine.dtype.kind == "f":
            equal = (equal & (np.signbit(mine) == np.signbit(yours))) | (np.isnan(mine) & np.isnan(yours))
        assert equal.all(), f"{name}: {mine[~equal][:4]} and {yours[~equal][:4]}"


def single(found: FloatArray) -> Float32Array:
    """Return single precision; what is too large becomes infinite."""
    with np.errstate(over="ignore"):
        return found.astype(np.float32)


class Draws:
    """Draws states and measurements.

    Args:
        seed: of the generator.
        shape: batch shape.
        odd: share of the numbers that are taken from `ODD`.
    """

    def __init__(self, seed: int, shape: tuple[int, ...], odd: float = 0.0) -> None:
        self.rng = np.random.default_rng(seed)
        self.shape = shape
        self._odd = odd

    def normal(self, *tail: int, mean: npt.ArrayLike = 0.0, spread: float = 1.0) -> FloatArray:
        size = (*self.shape, *tail)
        usual = self.rng.normal(mean, spread, size)
        return np.where(self.rng.random(size) < self._odd, self.rng.choice(ODD, size), usual)

    def place(self, spread: float) -> FloatArray:
        return self.normal(3, mean=[0.4, 0.0, 0.2], spread=spread)

    def seen(self, samples: int = 6) -> Seen:
        window = np.moveaxis(self.normal(samples, 6, spread=float(self.rng.choice([0.1, 3.0, 8.0]))), -2, 0)
        pressed = self.normal(mean=3.0, spread=4.0)
        window = np.ascontiguousarray(window)
        window[..., 2] += pressed
        return Seen(
            position=self.place(float(self.rng.choice([1e-4, 5e-3, 0.1]))),
            yaw=self.normal(mean=2.8, spread=0.3),
            tilt=self.normal(2, spread=0.06),
            wrench_window=window,
            hole_estimate=np.where(self.rng.random((*self.shape, 1)) < 0.3, np.nan, self.place(5e-3)),
            nominal_hole=self.place(1e-3),
            start_yaw=self.normal(mean=3.0, spread=0.3),
            last_joint=self.normal(spread=2.0),
        )

    def state(self, steps: PolicyStep) -> StepState:
        begun = steps.begin(np.zeros((*self.shape, 3)), np.zeros(self.shape))
        shape, rng = self.shape, self.rng

        def maybe(number: FloatArray) -> FloatArray:
            return np.where(rng.random(shape) < 0.5, number, np.nan)

        def counts(*special: int) -> Any:
            return np.where(
                rng.random(shape) < 0.2, rng.choice([0, 2**31 - 1, *special], shape), rng.integers(0, 9, shape)
            ).astype(np.int32)

        height = self.place(3e-3)[..., 2]
        return StepState(
            lock=DslState(
                phase=rng.choice(np.array([0, 0, 1, 1, 3, 2], np.int32), shape),
                z_lock=maybe(height),
                z_contact0=maybe(height + self.normal(spread=1e-3)),
                previous_n=self.normal(6, spread=0.4),
                previous_position=self.place(1e-3),
                fresh=np.asarray(rng.random(shape) < 0.2),
                seek_start_z=maybe(height + self.normal(spread=8e-3)),
                seek_steps=counts(3, 110),
                z_floor=self.normal(mean=0.19, spread=0.01),
            ),
            memory=ObservationState(
                frames=single(self.normal(*begun.memory.frames.shape[-2:])),
                hole_mean=self.place(1e-3),
                hole_count=counts(1),
                steps=counts(1),
            ),
            target_position=self.place(float(rng.choice([5e-3, 0.06]))),
            target_yaw=self.normal(mean=2.9, spread=0.3),
            previous_action=self.normal(4),
        )

    def action(self) -> FloatArray:
        return self.normal(4, spread=float(self.rng.choice([0.1, 1.0, 40.0])))
