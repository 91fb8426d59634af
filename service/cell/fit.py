"""The one answer to the question whether a policy fits a cell."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

from service.config import CellConfig, LimitsSection, RecipeSection
from service.policy.contract import PolicyContract
from service.policy.observation import ENTRIES, Need
from wire.modes import LockMode

EVERY_CELL_OFFERS = frozenset({Need.FORCE_TORQUE, Need.LAST_JOINT})
"""Contents of each driver's samples; the estimate of the hole depends on the configuration."""

_NAMES = {
    Need.FORCE_TORQUE: "a force/torque sensor",
    Need.HOLE: "a camera's estimate of the hole",
    Need.LAST_JOINT: "joint angles",
}


@dataclass(frozen=True, slots=True)
class CellCapabilities:
    """The cell's side of the comparison, for one recipe.

    Attributes:
        tick_s: period of its control law, s.
        part: part that the recipe assembles.
        clearance_m: clearance per face, if known.
        locks: modes of the lock that the recipe allows.
        offers: what it measures.
        limits: limits that no policy may exceed.
    """

    tick_s: float
    part: str
    clearance_m: float | None
    locks: tuple[LockMode, ...]
    offers: frozenset[Need]
    limits: LimitsSection

    @classmethod
    def of(cls, config: CellConfig, recipe: RecipeSection, tick_s: float) -> Self:
        """Return the capabilities of a configured cell.

        Args:
            config: of the cell.
            recipe: one of the cell's.
            tick_s: period of the driver's samples.
        """
        camera = {Need.HOLE} if config.sees_hole else set[Need]()
        return cls(
            tick_s=tick_s,
            part=recipe.part,
            clearance_m=recipe.clearance_m,
            locks=recipe.allow_lock,
            offers=EVERY_CELL_OFFERS | camera,
            limits=config.limits,
        )


def mismatches(contract: PolicyContract, cell: CellCapabilities) -> tuple[str, ...]:
    """Return every reason why the cell cannot run the policy as it was trained; empty where it can."""
    return (
        *_beyond_task(contract, cell),
        *_beyond_sensors(contract, cell),
        *_beyond_mode(contract, cell),
        *_beyond_law(contract, cell),
        *_beyond_lock(contract, cell),
        *_without_camera(contract, cell),
    )


def _beyond_task(contract: PolicyContract, cell: CellCapabilities) -> Iterator[str]:
    """Yield differences of period, part and clearance."""
    if contract.tick_s != cell.tick_s:
        yield f"the policy wants a tick of {contract.tick_s * 1e3:g} ms, the cell has {cell.tick_s * 1e3:g} ms"
    if cell.part not in contract.parts:
        yield f"the policy is for {', '.join(contract.parts)}, the cell assembles {cell.part}"
    low, high = contract.clearance_m
    if cell.clearance_m is not None and not low <= cell.clearance_m <= high:
        yield (
            f"the policy is for a clearance of {low * 1e3:g} to {high * 1e3:g} mm per face, "
            f"the cell has {cell.clearance_m * 1e3:g} mm"
        )


def _beyond_sensors(contract: PolicyContract, cell: CellCapabilities) -> Iterator[str]:
    """Yield observations that the cell cannot make."""
    offered = cell.offers if contract.uses_estimate else cell.offers | {Need.HOLE}
    for entry in contract.observation:
        for need in sorted(ENTRIES[entry.name].needs - offered):
            yield f"observation entry {entry.name!r} needs {_NAMES[need]}, which the cell does not have"


def _beyond_mode(contract: PolicyContract, cell: CellCapabilities) -> Iterator[str]:
    """Yield conflicts about the lock's mode and press."""
    lock = contract.dsl
    if lock.mode != "off" and Need.FORCE_TORQUE not in cell.offers:
        yield f"the safety lock in mode {lock.mode!r} needs a force/torque sensor"
    if lock.mode not in cell.locks:
        yield (
            f"the safety lock is in mode {lock.mode!r}, this recipe runs {', '.join(cell.locks)}: "
            "allow_lock of the recipe says which"
        )
    if lock.press_m > (most := cell.limits.max_press_m):
        yield f"dsl.press_m is {lock.press_m * 1e3:g} mm, the cell presses at most {most * 1e3:g} mm"


def _beyond_law(contract: PolicyContract, cell: CellCapabilities) -> Iterator[str]:
    """Yield numbers of the compliance law outside the cell's range."""
    law, limits = contract.compliance, cell.limits
    for name, wanted, least in (
        ("damping", law.damping, limits.min_damping),
        ("inertia", law.inertia, limits.min_inertia),
    ):
        for axis, (want, limit) in enumerate(zip(wanted, least, strict=True)):
            if want < limit:
                yield f"compliance.{name}[{axis}] is {want:g}, the cell runs at least {limit:g}"
    for axis, (want, limit) in enumerate(zip(law.stiffness, limits.max_stiffness, strict=True)):
        if want > limit:
            yield f"compliance.stiffness[{axis}] is {want:g}, the cell runs at most {limit:g}"
    for name, wanted, most in (
        ("damping", law.damping, limits.max_damping),
        ("inertia", law.inertia, limits.max_inertia),
    ):
        for axis, (want, limit) in enumerate(zip(wanted, most, strict=True)):
            if want > limit:
                yield f"compliance.{name}[{axis}] is {want:g}, limits.max_{name} of the cell is {limit:g}"


def _beyond_lock(contract: PolicyContract, cell: CellCapabilities) -> Iterator[str]:
    """Yield constants with which the lock would not protect."""
    lock, limits = contract.dsl, cell.limits
    if lock.mode == "off":
        return
    for clip, value, ceiling, unit in (
        ("force_clip_n", lock.force_clip_n, limits.force_ceiling_n, "N"),
        ("torque_clip_nm", lock.torque_clip_nm, limits.torque_ceiling_nm, "N·m"),
    ):
        most = limits.max_contact_share * ceiling
        threshold = lock.contact_threshold * value
        if threshold > most:
            yield (
                f"dsl.contact_threshold of dsl.{clip} is {threshold:g} {unit}, limits.max_contact_share of the cell's "
                f"ceiling is {most:.3g} {unit}"
            )
    for name, want, field, limit in (
        ("seek_step_m", lock.seek_step_m, "max_seek_step_m", limits.max_seek_step_m),
        ("lift_max_m", lock.lift_max_m, "max_lift_m", limits.max_lift_m),
        ("search_depth_m", lock.search_depth_m, "max_search_depth_m", limits.max_search_depth_m),
        ("search_steps", lock.search_steps, "max_search_steps", limits.max_search_steps),
    ):
        if want > limit:
            yield f"dsl.{name} is {want:g}, limits.{field} of the cell is {limit:g}"


def _without_camera(contract: PolicyContract, cell: CellCapabilities) -> Iterator[str]:
    """Yield the remedy where the approach needs an estimate of the hole that the cell does not have."""
    if contract.uses_estimate and Need.HOLE not in cell.offers:
        yield (
            f"mode {contract.mode} goes by a camera's estimate of the hole: describe the camera under [camera], "
            "or take a policy of mode FTM"
        )
