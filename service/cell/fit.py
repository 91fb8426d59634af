"""The one answer to the question whether a policy fits a cell."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf, sqrt
from typing import Self

from service.config import CellConfig, LimitsSection, PreflightSection, RecipeSection
from service.policy.contract import PolicyContract
from service.policy.observation import ENTRIES, Need
from service.safety.contact_loop import PAYLOAD_KG, why_not_law
from wire.impact import blow_n, reached_m_s
from wire.modes import LockMode

EVERY_CELL_OFFERS = frozenset({Need.FORCE_TORQUE, Need.LAST_JOINT})
"""Contents of each driver's samples; the estimate of the hole depends on the configuration."""
NOISE_DEVIATIONS = 5.0
"""Standard deviations of the noise of a mean that no run reaches by chance."""

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
        payload_kg: mass beyond the sensor.
        bears_n: momentary true force that the part bears, N; infinite if nobody says.
        approach_speed_m_s: speed of the scripted moves that the recipe asks for; None: one that the part bears.
        noise_force_n: standard deviation of a force component with which a run may begin, N.
    """

    tick_s: float
    part: str
    clearance_m: float | None
    locks: tuple[LockMode, ...]
    offers: frozenset[Need]
    limits: LimitsSection
    payload_kg: float = PAYLOAD_KG
    bears_n: float = inf
    approach_speed_m_s: float | None = None
    noise_force_n: float = PreflightSection().noise_force_n

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
            payload_kg=PAYLOAD_KG if config.ur is None else config.ur.payload_kg,
            bears_n=recipe.bears_n(config.limits.force_ceiling_n),
            approach_speed_m_s=recipe.approach_speed_m_s,
            noise_force_n=config.preflight.noise_force_n,
        )


def mismatches(contract: PolicyContract, cell: CellCapabilities) -> tuple[str, ...]:
    """Return every reason why the cell cannot run the policy as it was trained; empty where it can."""
    return (
        *_beyond_task(contract, cell),
        *_beyond_sensors(contract, cell),
        *_beyond_mode(contract, cell),
        *_beyond_law(contract, cell),
        *why_not_law(contract.compliance, cell.payload_kg),
        *_beyond_part(contract, cell),
        *_beyond_lock(contract, cell),
        *_touched_by_nothing(contract, cell),
        *_without_camera(contract, cell),
    )


def _beyond_task(contract: PolicyContract, cell: CellCapabilities) -> Iterator[str]:
    """Yield differences of period, part and clearance."""
    if contract.tick_s != cell.tick_s:
        yield f"the policy wants a tick of {contract.tick_s * 1e3:g} ms, the cell has {cell.tick_s * 1e3:g} ms"
    if contract.period_s >= (age_s := cell.limits.target_age_s):
        yield (
            f"the policy acts every {contract.period_s * 1e3:g} ms (ticks_per_step), the arm stops without a target "
            f"after {age_s * 1e3:g} ms (limits.target_age_s)"
        )
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


def _beyond_part(contract: PolicyContract, cell: CellCapabilities) -> Iterator[str]:
    """Yield speeds at which a touch would give more than the part bears."""
    law, limits = contract.compliance, cell.limits
    deepest = sum(entry.limit for entry in contract.action if entry.name == "dz")
    step_m = deepest if contract.dsl.mode == "off" else deepest + contract.dsl.seek_step_m
    # A step of the search is taken at once: within its period the tip goes as fast as the law pulls it
    for what, speed, lead_m, axes in (
        ("approach_speed_m_s of the recipe", cell.approach_speed_m_s or 0.0, limits.max_step_m, (0, 1, 2)),
        ("the search (dsl.seek_step_m and the action's dz)", limits.max_speed_m_s, step_m, (2,)),
    ):
        reached = reached_m_s(min(speed, limits.max_speed_m_s), min(lead_m, limits.max_step_m), law, axes)
        blow = blow_n(reached, max(law.inertia[:3]), limits.contact_n_m)
        if blow > cell.bears_n:
            yield (
                f"{what} reaches {reached:.3f} m/s: a touch gives up to {blow:.0f} N, the part bears "
                f"{cell.bears_n:g} N for a moment (impact_n of the recipe, or twice its force ceiling)"
            )


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


def _touched_by_nothing(contract: PolicyContract, cell: CellCapabilities) -> Iterator[str]:
    """Yield why the lock may take noise, or the payload's own inertia, for the contact that proves a success."""
    lock, law, limits = contract.dsl, contract.compliance, cell.limits
    reached = reached_m_s(limits.max_speed_m_s, limits.max_step_m, law, (2,))
    # The mean over a window cannot be more than the payload's momentum, turned round, over its length
    inertia_n = 2.0 * cell.payload_kg * reached / (contract.wrench_window_ticks * contract.tick_s)
    least = inertia_n + NOISE_DEVIATIONS * cell.noise_force_n / sqrt(contract.wrench_window_ticks)
    threshold = lock.contact_threshold * lock.force_clip_n
    if threshold < least:
        yield (
            f"dsl.contact_threshold of dsl.force_clip_n is {threshold:g} N: without a contact, noise and the tool's "
            f"own inertia reach {least:.1f} N over wrench_window_ticks ({contract.wrench_window_ticks})"
        )


def _without_camera(contract: PolicyContract, cell: CellCapabilities) -> Iterator[str]:
    """Yield the remedy where the approach needs an estimate of the hole that the cell does not have."""
    if contract.uses_estimate and Need.HOLE not in cell.offers:
        yield (
            f"mode {contract.mode} goes by a camera's estimate of the hole: describe the camera under [camera], "
            "or take a policy of mode FTM"
        )
