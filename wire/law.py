"""The compliance law, and the limits that an arm's own controller enforces."""

from dataclasses import dataclass, fields
from math import inf

from wire.arrays import Corner, Six
from wire.limits import MAX_SPEED, MAX_STEP, TARGET_AGE_S


@dataclass(frozen=True, slots=True)
class ComplianceLaw:
    """Compliance of the arm about its TCP, base axes: inertia · v̇ = stiffness · e − damping · v + wrench.

    The components of each attribute are x, y, z, then the rotations about them.

    Attributes:
        stiffness: stiffness, N/m and N·m/rad.
        damping: damping, N·s/m and N·m·s/rad.
        inertia: virtual mass and inertia, kg and kg·m².
    """

    stiffness: Six
    damping: Six
    inertia: Six

    def __post_init__(self) -> None:
        """Refuse numbers that do not make a law.

        Raises:
            ValueError: there are not six components, or one is not a finite number above zero; the text names it.
        """
        for field in fields(self):
            components = getattr(self, field.name)
            if len(components) != 6:
                raise ValueError(f"compliance.{field.name} has {len(components)} components, it needs 6")
            for axis, component in enumerate(components):
                if not 0.0 < component < inf:
                    name = f"compliance.{field.name}.{axis}"
                    raise ValueError(f"{name} must be a finite number above zero, not {component!r}")


@dataclass(frozen=True, slots=True)
class ControlLimits:
    """Limits that the control program on the arm's controller enforces by itself while engaged.

    Attributes:
        workspace: lower and upper corner of the box for the TCP's position, base frame, m.
        force_ceiling_n: resultant of the compensated force at which the program stops, N.
        max_speed: largest speed of the reference, m/s and rad/s.
        max_step: largest change between consecutive targets, m and rad.
        target_age_s: time without a new target after which the program stops, s.
    """

    workspace: tuple[Corner, Corner]
    force_ceiling_n: float
    max_speed: tuple[float, float] = MAX_SPEED
    max_step: tuple[float, float] = MAX_STEP
    target_age_s: float = TARGET_AGE_S
