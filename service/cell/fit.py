"""The one answer to the question whether a policy fits a cell."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf
from typing import Self

from service.config import CellConfig, RecipeSection
from service.policy.contract import PolicyContract
from service.policy.observation import ENTRIES, Need
from wire.modes import LockMode

Six = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class CellCapabilities:
    """The cell's side of the comparison, for one recipe.

    Attributes:
        tick_s: period of its control law, s.
        part: part that the recipe assembles.
        clearance_m: clearance per face, if known.
        camera: whether it has an estimate of the hole's position.
        force_torque: whether it has a force/torque sensor.
        last_joint: whether it reports joint angles.
        stiffness_max: largest stiffness that its law runs, N/m and N·m/rad.
        damping_min: least damping, N·s/m and N·m·s/rad.
        inertia_min: least inertia, kg and kg·m².
        locks: modes of the lock that the recipe allows.
        press_max_m: largest depth that the lock may press below the height of a contact, m.
        damping_max: largest damping, N·s/m and N·m·s/rad.
        inertia_max: largest inertia, kg and kg·m².
        contact_max_n: largest force at which the lock may take something for a contact, N.
        contact_max_nm: the same for torque, N·m.
        seek_step_max_m: largest step downwards while the lock seeks, m.
        lift_max_m: largest height above the first contact that the lock may rise to, m.
        search_depth_max_m: largest depth of one stretch of search for contact, m.
        search_steps_max: largest length of one, policy steps.
    """

    tick_s: float
    part: str
    clearance_m: float | None
    camera: bool
    force_torque: bool
    last_joint: bool
    stiffness_max: Six
    damping_min: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    inertia_min: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    locks: tuple[LockMode, ...] = ("paper",)
    press_max_m: float = 5e-3
    damping_max: Six = (inf, inf, inf, inf, inf, inf)
    inertia_max: Six = (inf, inf, inf, inf, inf, inf)
    contact_max_n: float = inf
    contact_max_nm: float = inf
    seek_step_max_m: float = inf
    lift_max_m: float = inf
    search_depth_max_m: float = inf
    search_steps_max: float = inf

    @classmethod
    def of(cls, config: CellConfig, recipe: RecipeSection, tick_s: float) -> Self:
        """Return the capabilities of a configured cell.

        Args:
            config: of the cell.
            recipe: one of the cell's.
            tick_s: period of the driver's samples.
        """
        limits = config.limits
        return cls(
            tick_s=tick_s,
            part=recipe.part,
            clearance_m=recipe.clearance_m,
            camera=config.sees_hole,
            force_torque=True,
            last_joint=True,
            stiffness_max=limits.max_stiffness,
            damping_min=limits.min_damping,
            inertia_min=limits.min_inertia,
            locks=recipe.allow_lock,
            press_max_m=limits.max_press_m,
            damping_max=limits.max_damping,
            inertia_max=limits.max_inertia,
            contact_max_n=limits.max_contact_share * limits.force_ceiling_n,
            contact_max_nm=limits.max_contact_share * limits.torque_ceiling_nm,
            seek_step_max_m=limits.max_seek_step_m,
            lift_max_m=limits.max_lift_m,
            search_depth_max_m=limits.max_search_depth_m,
            search_steps_max=limits.max_search_steps,
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
    offered = {
        Need.FORCE_TORQUE: (cell.force_torque, "a force/torque sensor"),
        Need.HOLE: (cell.camera or contract.mode == "FTM", "a camera's estimate of the hole"),
        Need.LAST_JOINT: (cell.last_joint, "joint angles"),
    }
    for entry in contract.observation:
        for need in sorted(ENTRIES[entry.name].needs):
            has, thing = offered[need]
            if not has:
                yield f"observation entry {entry.name!r} needs {thing}, which the cell does not have"


def _beyond_mode(contract: PolicyContract, cell: CellCapabilities) -> Iterator[str]:
    """Yield conflicts about the lock's mode and press."""
    lock = contract.dsl
    if lock.mode != "off" and not cell.force_torque:
        yield f"the safety lock in mode {lock.mode!r} needs a force/torque sensor"
    if lock.mode not in cell.locks:
        yield (
            f"the safety lock is in mode {lock.mode!r}, this recipe runs {', '.join(cell.locks)}: "
            "allow_lock of the recipe says which"
        )
    if lock.press_m > cell.press_max_m:
        yield f"dsl.press_m is {lock.press_m * 1e3:g} mm, the cell presses at most {cell.press_max_m * 1e3:g} mm"


def _beyond_law(contract: PolicyContract, cell: CellCapabilities) -> Iterator[str]:
    """Yield numbers of the compliance law outside the cell's range."""
    law = contract.compliance
    for name, wanted, least in (
        ("damping", law.damping, cell.damping_min),
        ("inertia", law.inertia, cell.inertia_min),
    ):
        for axis, (want, limit) in enumerate(zip(wanted, least, strict=True)):
            if want < limit:
                yield f"compliance.{name}[{axis}] is {want:g}, the cell runs at least {limit:g}"
    for axis, (want, limit) in enumerate(zip(law.stiffness, cell.stiffness_max, strict=True)):
        if want > limit:
            yield f"compliance.stiffness[{axis}] is {want:g}, the cell runs at most {limit:g}"
    for name, wanted, most in (
        ("damping", law.damping, cell.damping_max),
        ("inertia", law.inertia, cell.inertia_max),
    ):
        for axis, (want, limit) in enumerate(zip(wanted, most, strict=True)):
            if want > limit:
                yield f"compliance.{name}[{axis}] is {want:g}, limits.max_{name} of the cell is {limit:g}"


def _beyond_lock(contract: PolicyContract, cell: CellCapabilities) -> Iterator[str]:
    """Yield constants with which the lock would not protect."""
    lock = contract.dsl
    if lock.mode == "off":
        return
    for clip, value, most, unit in (
        ("force_clip_n", lock.force_clip_n, cell.contact_max_n, "N"),
        ("torque_clip_nm", lock.torque_clip_nm, cell.contact_max_nm, "N·m"),
    ):
        threshold = lock.contact_threshold * value
        if threshold > most:
            yield (
                f"dsl.contact_threshold of dsl.{clip} is {threshold:g} {unit}, limits.max_contact_share of the cell's "
                f"ceiling is {most:.3g} {unit}"
            )
    for name, want, field, limit in (
        ("seek_step_m", lock.seek_step_m, "max_seek_step_m", cell.seek_step_max_m),
        ("lift_max_m", lock.lift_max_m, "max_lift_m", cell.lift_max_m),
        ("search_depth_m", lock.search_depth_m, "max_search_depth_m", cell.search_depth_max_m),
        ("search_steps", lock.search_steps, "max_search_steps", cell.search_steps_max),
    ):
        if want > limit:
            yield f"dsl.{name} is {want:g}, limits.{field} of the cell is {limit:g}"


def _without_camera(contract: PolicyContract, cell: CellCapabilities) -> Iterator[str]:
    """Yield the remedy where the approach needs an estimate of the hole that the cell does not have."""
    if contract.mode != "FTM" and not cell.camera:
        yield (
            f"mode {contract.mode} goes by a camera's estimate of the hole: describe the camera under [camera], "
            "or take a policy of mode FTM"
        )
