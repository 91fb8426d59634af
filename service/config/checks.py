"""Contradictions between fields. Each function yields one sentence per contradiction; the sentence names the fields."""

from collections.abc import Iterator, Mapping
from math import hypot

from service.config.limits import LimitsSection, PreflightSection
from service.config.sections import CellSection, RecipeSection, SimSection
from service.config.ur import RATINGS, UrSection
from wire.impact import fastest_m_s
from wire.modes import RESTING_PERIOD_S


def within_limits(limits: LimitsSection) -> Iterator[str]:
    """Yield contradictions among the limits."""
    if limits.policy_deadline_s >= limits.target_age_s:
        yield "limits.policy_deadline_s must be below limits.target_age_s, or the arm stops first"
    if limits.stuck_channel_samples < limits.stuck_samples:
        yield "limits.stuck_channel_samples must not be below limits.stuck_samples"
    for name, least, most in (
        ("damping", limits.min_damping, limits.max_damping),
        ("inertia", limits.min_inertia, limits.max_inertia),
    ):
        if any(low > high for low, high in zip(least, most, strict=True)):
            yield f"limits.min_{name} must not be above limits.max_{name} on any axis"


def within_preflight(preflight: PreflightSection) -> Iterator[str]:
    """Yield contradictions among the requirements before the arm moves."""
    if preflight.bias_force_n >= preflight.contact_force_n:
        yield "preflight.bias_force_n must be below preflight.contact_force_n"


def between_limits_and_preflight(limits: LimitsSection, preflight: PreflightSection) -> Iterator[str]:
    """Yield requirements before the arm moves that the ceiling makes pointless."""
    if preflight.contact_force_n >= limits.force_ceiling_n:
        yield (
            f"preflight.contact_force_n is {preflight.contact_force_n:g} N, it must be below limits.force_ceiling_n "
            f"({limits.force_ceiling_n:g} N)"
        )


def samples_too_rare(cell: CellSection, sim: SimSection, limits: LimitsSection) -> Iterator[str]:
    """Yield an age of samples that a simulated cell at rest reaches."""
    rests = cell.driver == "zenoh_sim" and sim.mode == "real_time"
    if rests and limits.sample_age_s < 2 * RESTING_PERIOD_S:
        yield (
            f"limits.sample_age_s is {limits.sample_age_s:g} s, a simulated cell in real time needs at least "
            f"{2 * RESTING_PERIOD_S:g} s: at rest it gives a sample every {RESTING_PERIOD_S:g} s"
        )


def recipes_beyond_limits(recipes: Mapping[str, RecipeSection], limits: LimitsSection) -> Iterator[str]:
    """Yield numbers of recipes that the cell's limits do not allow."""
    for name, recipe in recipes.items():
        ceiling = recipe.force_ceiling_n
        if ceiling is not None and ceiling > limits.force_ceiling_n:
            yield (
                f"recipes.{name}.force_ceiling_n is {ceiling} N, above limits.force_ceiling_n "
                f"({limits.force_ceiling_n} N)"
            )
        yield from _too_fast(name, recipe, limits)
        x, y, z = recipe.nominal_hole_m
        for field, point in (
            ("start_position_m", recipe.start_position_m),
            ("nominal_hole_m, less success_depth_m,", (x, y, z - recipe.success_depth_m)),
        ):
            if not _inside(point, limits.workspace_m):
                yield f"recipes.{name}.{field} is {_metres(point)}, outside limits.workspace_m"


def without_robot(cell: CellSection, ur: UrSection | None) -> Iterator[str]:
    """Yield the section that the driver lacks."""
    if cell.driver == "ur" and ur is None:
        yield "cell.driver is ur, so the section [ur] must say where the controller is and what it carries"


def beyond_arm(ur: UrSection, recipes: Mapping[str, RecipeSection], limits: LimitsSection) -> Iterator[str]:
    """Yield numbers beyond the ratings of the arm."""
    rating = RATINGS[ur.arm]
    if ur.model is not None and ur.model.rstrip("e") != ur.arm.rstrip("e"):
        yield f"ur.model is {ur.model}, ur.arm is {ur.arm}: name one arm"
    for field, value, most, unit in (
        ("payload_kg", ur.payload_kg, rating.payload_kg, "kg"),
        ("force_range_n", ur.force_range_n, rating.force_range_n, "N"),
        ("torque_range_nm", ur.torque_range_nm, rating.torque_range_nm, "N·m"),
    ):
        if value > most:
            yield f"ur.{field} is {value:g} {unit}, a {ur.arm} (ur.arm) is rated for {most:g} {unit}"
    farthest_m = rating.reach_m + hypot(*ur.tcp_m[:3])
    for name, recipe in recipes.items():
        for field, point in (("start_position_m", recipe.start_position_m), ("nominal_hole_m", recipe.nominal_hole_m)):
            if hypot(*point) > farthest_m:
                yield (
                    f"recipes.{name}.{field} is {_metres(point)}, {hypot(*point):.3g} m from the base; a {ur.arm} "
                    f"(ur.arm) with this tool reaches {farthest_m:.3g} m"
                )
    if any(abs(value) > farthest_m for corner in limits.workspace_m for value in corner):
        yield (
            f"limits.workspace_m bounds nothing: a {ur.arm} (ur.arm) with this tool reaches {farthest_m:.3g} m, and a "
            "corner lies beyond"
        )


def _too_fast(name: str, recipe: RecipeSection, limits: LimitsSection) -> Iterator[str]:
    """Yield an approach speed beyond the cell's, or beyond what the part bears under the lightest law allowed."""
    speed = recipe.approach_speed_m_s
    if speed is None:
        return
    if speed > limits.max_speed_m_s:
        yield f"recipes.{name}.approach_speed_m_s is {speed}, above limits.max_speed_m_s ({limits.max_speed_m_s})"
    bears_n = recipe.bears_n(limits.force_ceiling_n)
    fastest = fastest_m_s(bears_n, min(limits.min_inertia[:3]), limits.contact_n_m)
    if speed > fastest:
        yield (
            f"recipes.{name}.approach_speed_m_s is {speed}: the part bears {bears_n:g} N for a moment (impact_n, or "
            f"twice its force ceiling), and a touch at more than {fastest:.3f} m/s gives more"
        )


def _inside(point: tuple[float, float, float], box: tuple[tuple[float, ...], tuple[float, ...]]) -> bool:
    lower, upper = box
    return all(low <= value <= high for low, value, high in zip(lower, point, upper, strict=True))


def _metres(point: tuple[float, float, float]) -> str:
    return f"[{', '.join(f'{value:.4g}' for value in point)}] m"
