"""Twins: the same object twice, one computed by the compiled tick and one by numpy, and their arrays side by side."""

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
import pytest

from sim_backend.world import compiled
from sim_backend.world.arm import ArmController
from sim_backend.world.sensor import ForceTorqueSensor
from sim_backend.world.telling import REPORT
from sim_backend.world.world import World
from wire.records import STATE

Made = TypeVar("Made")
APART = {"_constants", "_singular", "_errors", "_jacobians", "_sensed", "_noise", "_jitter"}
"""Arrays that only the compiled tick uses, and large ones that no tick changes."""

needs_the_extension = pytest.mark.skipif(
    compiled.tick is None, reason=f"the compiled tick is not used, {compiled.absence}"
)


def twins(make: Callable[[], Made]) -> tuple[Made, Made]:
    """Make an object twice: compiled, and in numpy alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled, "tick", None)
        plain = make()
    return make(), plain


def arrays(*owners: Any) -> dict[str, np.ndarray]:
    """Return the arrays of objects, by name."""
    return {
        f"{type(owner).__name__}.{name}": value
        for owner in owners
        for name, value in (vars(owner) if hasattr(owner, "__dict__") else _slots(owner)).items()
        if isinstance(value, np.ndarray) and name not in APART
    }


def _slots(owner: Any) -> dict[str, Any]:
    return {name: getattr(owner, name) for name in owner.__slots__}


def of_arm(arm: ArmController) -> dict[str, np.ndarray]:
    return arrays(arm, arm.law, arm.reference, arm._servo)


def of_sensor(sensor: ForceTorqueSensor) -> dict[str, np.ndarray]:
    return arrays(sensor)


def of_world(world: World) -> dict[str, np.ndarray]:
    return of_arm(world.arm) | of_sensor(world.sensor) | arrays(world) | told(world)


def told(world: World) -> dict[str, np.ndarray]:
    """Return what a world tells of itself, by name."""
    record = np.zeros(world.n, STATE)
    report = tuple(record[name] for name in REPORT)
    world.telling.write(report)
    return dict(zip(REPORT, report, strict=True)) | {"unzeroed": world.sensor.unzeroed(world.rotation)}


def assert_equal(one: dict[str, np.ndarray], other: dict[str, np.ndarray], when: object) -> None:
    """Assert that arrays are the same bit for bit; zeros of either sign and all that is no number count as the same."""
    assert one.keys() == other.keys()
    for name, value in one.items():
        assert np.array_equal(value, other[name], equal_nan=value.dtype.kind == "f"), f"{name} differs at {when}"
