"""Judges whether a peg sits in its hole, and whether a run is still about its hole. Depth alone tells neither.

Depth is measured from a surface, and the surface is an estimate: a tip in free air is deep below a surface that is
believed too high, and a tip beside the block is deep below the block's top. A peg counts as seated once three things
agree: its depth, its place beside the hole, and a witness. The witness is a first contact at the height where the
hole's mouth is expected. Without one, `service.safety.probe` asks the walls.
"""

from dataclasses import dataclass, fields
from enum import StrEnum
from math import hypot, isfinite

from wire.arrays import FloatArray

GRASP_M = 1.5e-3
"""Largest distance of the peg's axis from the TCP, m: its offset in the fingers and its tilt."""
STRAY_PER_CLEARANCE = 2.0
"""Largest distance of a seated peg's axis from the hole's, over the clearance per face: in a corner of a triangle."""

SETTLED_STEPS = 2
"""Policy steps in a row with a finding, `NOT_DEEP` excepted, of which the last counts."""


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Largest error of the known position of the hole's mouth.

    Attributes:
        lateral_m: horizontal error, m.
        height_m: vertical error, m.
        unfelt_m: depth beyond the success depth that a tip without a contact needs before the walls are asked, m.
    """

    lateral_m: float
    height_m: float
    unfelt_m: float


CAMERA = Tolerance(6e-3, 2.5e-3, 0.0)
"""Tolerance of the camera's estimate: five standard deviations of the standard conditions."""
NOMINAL = Tolerance(15.5e-3, 12e-3, 12e-3)
"""Tolerance of a recipe's nominal hole: the paper's search domain of ±10 mm, with its corners. In free air the
search goes on until the mouth must have been passed."""


@dataclass(frozen=True, slots=True)
class SeatingParameters:
    """Requirements on a seated peg, and the room of a run.

    Attributes:
        success_depth_m: depth of the peg's bottom below the mouth that counts as inserted, m.
        clearance_m: clearance per face, m.
        tolerance: of what is known of the hole.
        search_m: distance beyond the tolerance that a search may lead the tip from the hole, m.
        above_m: largest height of the tip above the mouth, m.
    """

    success_depth_m: float
    clearance_m: float
    tolerance: Tolerance
    search_m: float
    above_m: float

    def __post_init__(self) -> None:
        """Refuse requirements that nothing or everything meets.

        Raises:
            ValueError: a field is out of range; the text names it.
        """
        for field in fields(self):
            if field.name == "tolerance":
                continue
            value = getattr(self, field.name)
            if not (isfinite(value) and value > 0):
                raise ValueError(f"seating.{field.name} must be finite and above zero, not {value!r}")

    @property
    def seat_m(self) -> float:
        """Largest distance of the TCP from the known hole with the peg in the hole, m."""
        return self.tolerance.lateral_m + STRAY_PER_CLEARANCE * self.clearance_m + GRASP_M

    @property
    def room_m(self) -> float:
        """Largest distance of the TCP from the known hole in a run, m, horizontally."""
        return self.seat_m + self.search_m

    def why_stray(self, hole: FloatArray, tip: FloatArray) -> str | None:
        """Return why a tip is no longer about its hole; None while it is. A tip that is not finite is not.

        Args:
            hole: (3,) m, known position of the hole's mouth, base frame.
            tip: (3,) m, measured TCP, base frame.
        """
        beside, above = _beside(hole, tip), float(tip[2] - hole[2])
        if not beside <= self.room_m:
            return f"the tip is {beside * 1e3:.1f} mm beside the hole, limit {self.room_m * 1e3:.1f} mm"
        if not above <= self.above_m:
            return f"the tip is {above * 1e3:.1f} mm above the hole, limit {self.above_m * 1e3:.1f} mm"
        return None


class Finding(StrEnum):
    NOT_DEEP = "NOT_DEEP"
    SEATED = "SEATED"
    """Depth, place and contact agree."""
    UNPROVEN = "UNPROVEN"
    """Deep below where the mouth is expected, without a contact there: the walls must tell."""
    CONTRADICTED = "CONTRADICTED"
    """Measurements contradict each other; the run cannot succeed."""


@dataclass(frozen=True, slots=True)
class Seat:
    """Judgement of one policy step.

    Attributes:
        depth_m: depth of the tip below the surface, m: the surface that was felt, else the one that is expected.
        finding: what the measurements say together.
        text: what speaks against a seated peg, for people; empty where nothing does.
    """

    depth_m: float
    finding: Finding
    text: str = ""


def judge(parameters: SeatingParameters, hole: FloatArray, contact_m: float, tip: FloatArray) -> Seat:
    """Judge where the tip is.

    Args:
        parameters: requirements.
        hole: (3,) m, known position of the hole's mouth, base frame.
        contact_m: height of the first contact, m, base frame; NaN before it.
        tip: (3,) m, measured TCP, base frame.
    """
    expected, height = float(hole[2]), float(tip[2])
    above = contact_m - expected
    height_m = parameters.tolerance.height_m
    if above >= height_m:
        text = f"the first contact was {above * 1e3:.1f} mm above the hole's mouth, tolerance {height_m * 1e3:g} mm"
        return Seat(contact_m - height, Finding.CONTRADICTED, text)
    # A first contact far below the mouth was made in the hole, or the mouth is lower than expected
    felt = above > -height_m
    depth = (contact_m if felt else expected) - height
    if not depth > parameters.success_depth_m + (0.0 if felt else parameters.tolerance.unfelt_m):
        return Seat(depth, Finding.NOT_DEEP)
    beside = _beside(hole, tip)
    if not beside <= parameters.seat_m:
        text = (
            f"the tip is {depth * 1e3:.1f} mm below the surface, and {beside * 1e3:.1f} mm beside the hole, where at "
            f"most {parameters.seat_m * 1e3:.1f} mm are possible"
        )
        return Seat(depth, Finding.CONTRADICTED, text)
    if felt:
        return Seat(depth, Finding.SEATED)
    text = f"the tip is {depth * 1e3:.1f} mm below where the hole's mouth is expected, without a contact there"
    return Seat(depth, Finding.UNPROVEN, text)


class Seating:
    """Follows one run's findings.

    Args:
        parameters: requirements.
    """

    __slots__ = ("_parameters", "_steps")

    def __init__(self, parameters: SeatingParameters) -> None:
        self._parameters = parameters
        self._steps = 0

    def observe(self, hole: FloatArray, contact_m: float, tip: FloatArray) -> tuple[Seat, bool]:
        """Judge one policy step, arguments as for `judge`; also return whether its finding counts."""
        seat = judge(self._parameters, hole, contact_m, tip)
        self._steps = 0 if seat.finding is Finding.NOT_DEEP else self._steps + 1
        return seat, self._steps >= SETTLED_STEPS


def _beside(hole: FloatArray, tip: FloatArray) -> float:
    return hypot(float(tip[0] - hole[0]), float(tip[1] - hole[1]))
