"""Contradictions between fields. Each function yields one sentence per contradiction; the sentence names the fields."""

from collections.abc import Iterator, Mapping

from service.config.limits import LimitsSection, PreflightSection
from service.config.sections import CellSection, RecipeSection
from service.config.ur import UrSection


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


def recipes_beyond_limits(recipes: Mapping[str, RecipeSection], limits: LimitsSection) -> Iterator[str]:
    """Yield numbers of recipes that the cell's limits do not allow."""
    for name, recipe in recipes.items():
        ceiling = recipe.force_ceiling_n
        if ceiling is not None and ceiling > limits.force_ceiling_n:
            yield (
                f"recipes.{name}.force_ceiling_n is {ceiling} N, above limits.force_ceiling_n "
                f"({limits.force_ceiling_n} N)"
            )
        if recipe.approach_speed_m_s > limits.max_speed_m_s:
            yield (
                f"recipes.{name}.approach_speed_m_s is {recipe.approach_speed_m_s}, above limits.max_speed_m_s "
                f"({limits.max_speed_m_s})"
            )


def without_robot(cell: CellSection, ur: UrSection | None) -> Iterator[str]:
    """Yield the section that the driver lacks."""
    if cell.driver == "ur" and ur is None:
        yield "cell.driver is ur, so the section [ur] must say where the controller is and what it carries"
