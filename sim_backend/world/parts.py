"""The six pegs and their holes, and the test of whether a peg fits.

The paper states no sizes. It states its gaps as proportions: hole area minus peg area, over hole area. The sizes here
are solved from those proportions at the clearance per face `c` of the gap with which the part was tested (the paper's
"4 mm" is c = 4/3 mm, its "1 mm" c = 1/3 mm), and rounded to 0.1 mm:

| part | size | c, mm | proportion, % | paper, % |
|---|---|---|---|---|
| tr | side 28.0 mm | 4/3 | 26.31 | 26.3 |
| tr | side 28.0 mm | 1/3 | 7.76 | 7.8 |
| rtr | width 19.4 mm | 4/3 | 24.72 | 24.7 |
| trm | side 23.0 mm | 4/3 | 30.65 | 30.65 |
| trm | side 23.0 mm | 1/3 | 9.33 | 9.33 |
| cir | diameter 34.7 mm | 4/3 | 13.76 | 13.78 |
| b-rtr | width 25.9 mm | 1/3 | 5.50 | 5.5 |
| b-trm | side 38.0 mm | 4/3 | 20.50 | 20.50 |
| b-trm | side 38.0 mm | 1/3 | 5.81 | 5.8 |

tr is an equilateral triangle. rtr is a Reuleaux triangle (three arcs, each about the opposite corner). trm is a
triangle whose corner is cut off by a fourth face that also touches the incircle (the only cut at which both of its
proportions hold). cir is a circle. b- marks the big one of its kind. Part frame: origin at the centre of the incircle,
x axis towards a corner; for trm, towards the missing corner. Every outline is symmetric about the x axis, so it looks
the same from above and from the tool.

A hole is the parallel offset of the peg's faces by c, with sharp corners. The clearance is a parameter, so one peg fits
many holes. The wall of a curved face is a set of planes tangent to the offset arc, 12° apart on the Reuleaux triangles
and 20° apart on the circle (18 walls each), never nearer to the peg than c. Between two planes the hole is wider than
an arc of radius r by at most r (sec 6° - 1): 0.11 mm for rtr and 0.14 mm for b-rtr at c = 1/3 mm. The collision outline
of a Reuleaux peg has its vertices on the true arcs at the points where the walls are tangent, so its distance to every
wall is c too; its edges lie at most r (1 - cos 6°) inside the arc. cir is a true cylinder: centred, it is c from every
wall, and it moves off centre by at most c sec 10° = 1.015 c.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from wire.arrays import BoolArray, FloatArray

PEG_HEIGHT_M = 0.05
HOLE_DEPTH_M = 0.024


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A peg's cross-section, in the part frame of this module.

    Attributes:
        name: name in the paper.
        size_m: side of the (whole) triangle, width of the Reuleaux triangle, or diameter.
        outline: (k, 2) collision polygon, counter-clockwise, read-only; for cir a polygon for drawing only.
        wall_angle: (w,) direction of each wall of the hole, seen from the centre, rad, rising within (-π, π].
        wall_reach: (w,) distance from the centre to the peg's face, or tangent to its curve, in that direction, m.
        area_m2: area of the true, unfaceted peg.
        symmetry_order: rotations by 2π over this number leave the peg unchanged; 0 if every rotation does.
        face: kind of the true outline's faces.
        peg_height_m: height along the insertion axis.
    """

    name: str
    size_m: float
    outline: FloatArray
    wall_angle: FloatArray
    wall_reach: FloatArray
    area_m2: float
    symmetry_order: int
    face: Literal["straight", "arc", "circle"]
    peg_height_m: float = PEG_HEIGHT_M

    def __post_init__(self) -> None:
        for array in (self.outline, self.wall_angle, self.wall_reach):
            array.setflags(write=False)

    @property
    def is_cylinder(self) -> bool:
        """The collision peg is a true cylinder of radius `radius_m`, not a prism over `outline`."""
        return self.face == "circle"

    @property
    def radius_m(self) -> float:
        """Radius of the smallest circle about the origin that contains the peg; for cir, of the cylinder."""
        return 0.5 * self.size_m if self.is_cylinder else float(np.hypot(*self.outline.T).max())

    @property
    def wall_normal(self) -> FloatArray:
        """(w, 2) outward unit normals of the hole, one per wall."""
        return np.stack((np.cos(self.wall_angle), np.sin(self.wall_angle)), -1)


def _triangle(name: str, side: float) -> Part:
    inradius = side / math.sqrt(12.0)
    corners = np.radians([-120.0, 0.0, 120.0])
    outline = 2.0 * inradius * np.stack((np.cos(corners), np.sin(corners)), -1)
    walls = np.radians([-60.0, 60.0, 180.0])
    return _tangential(name, side, outline, walls, inradius, symmetry_order=3)


def _cut_triangle(name: str, side: float) -> Part:
    inradius = side / math.sqrt(12.0)
    cut = side / 6.0  # half the length of the fourth face
    outline = np.array(
        [[-inradius, -side / 2.0], [inradius, -cut], [inradius, cut], [-inradius, side / 2.0]],
    )
    walls = np.radians([-60.0, 0.0, 60.0, 180.0])
    return _tangential(name, side, outline, walls, inradius, symmetry_order=1)


def _tangential(
    name: str, size: float, outline: FloatArray, walls: FloatArray, inradius: float, symmetry_order: int
) -> Part:
    x, y = outline.T
    area = 0.5 * float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
    return Part(
        name=name,
        size_m=size,
        outline=outline,
        wall_angle=walls,
        wall_reach=np.full(len(walls), inradius),
        area_m2=area,
        symmetry_order=symmetry_order,
        face="straight",
    )


def _reuleaux(name: str, width: float) -> Part:
    to_corner = width / math.sqrt(3.0)
    outline: list[FloatArray] = []
    walls: list[float] = []
    for middle in (-180.0, -60.0, 60.0):  # normal at the middle of an arc, whose centre is the opposite corner
        normals = np.radians(middle + np.array([-30.0, -18.0, -6.0, 6.0, 18.0, 30.0]))
        centre = -to_corner * np.array([math.cos(math.radians(middle)), math.sin(math.radians(middle))])
        points = centre + width * np.stack((np.cos(normals), np.sin(normals)), -1)
        outline.append(points[:-1])  # the arc's last point is the next arc's first
        walls += normals.tolist()
    vertices = np.concatenate(outline)
    angles = np.array(walls)
    angles = np.sort(np.where(angles < -math.pi, angles + 2.0 * math.pi, angles))
    faces = np.stack((np.cos(angles), np.sin(angles)), -1)

    return Part(
        name=name,
        size_m=width,
        outline=vertices,
        wall_angle=angles,
        wall_reach=(vertices @ faces.T).max(0),
        area_m2=0.5 * (math.pi - math.sqrt(3.0)) * width**2,
        symmetry_order=3,
        face="arc",
    )


def _circle(name: str, diameter: float, facets: int = 18) -> Part:
    radius = 0.5 * diameter
    angles = np.radians(np.arange(1, facets + 1) * 360.0 / facets - 180.0)
    return Part(
        name=name,
        size_m=diameter,
        outline=radius * np.stack((np.cos(angles), np.sin(angles)), -1),
        wall_angle=angles,
        wall_reach=np.full(facets, radius),
        area_m2=math.pi * radius**2,
        symmetry_order=0,
        face="circle",
    )


PARTS: dict[str, Part] = {
    part.name: part
    for part in (
        _triangle("tr", 28.0e-3),
        _reuleaux("rtr", 19.4e-3),
        _cut_triangle("trm", 23.0e-3),
        _circle("cir", 34.7e-3),
        _reuleaux("b-rtr", 25.9e-3),
        _cut_triangle("b-trm", 38.0e-3),
    )
}


def proportion(part: Part, clearance: npt.ArrayLike) -> FloatArray:
    """Return (hole area - peg area) / hole area, (...), for the true shapes and clearances per face (...), m."""
    gap = np.asarray(clearance, np.float64)
    if part.face == "arc":
        # Three discs about the peg's corners: a triangle of side `chord` and three segments.
        width, radius = part.size_m, part.size_m + gap
        chord = np.sqrt(3.0 * radius**2 - 0.75 * width**2) - 0.5 * width
        opening = 2.0 * np.arcsin(chord / (2.0 * radius))
        hole = math.sqrt(3.0) / 4.0 * chord**2 + 1.5 * radius**2 * (opening - np.sin(opening))
        return 1.0 - part.area_m2 / hole
    # Every face touches the incircle, so offsetting them scales the outline.
    return 1.0 - (1.0 + gap / part.wall_reach.min()) ** -2


def hole_walls(part: Part, clearance: npt.ArrayLike) -> FloatArray:
    """Return the walls of the hole for clearances per face (...), m.

    Returns:
        (..., w, 3): angle of the outward normal, rad; distance of the wall's face from the hole's centre, m; least half
            length, m, at which a face centred on the foot of its normal meets its neighbours. A point x lies in the
            hole if `normal · x <= distance` for every wall. The number of walls depends on the part only.
    """
    distance = _wall_distances(part, clearance)
    previous, following = np.roll(distance, 1, -1), np.roll(distance, -1, -1)
    before = np.remainder(part.wall_angle - np.roll(part.wall_angle, 1), 2.0 * math.pi)
    after = np.roll(before, -1)
    half_length = np.maximum(
        (previous - distance * np.cos(before)) / np.sin(before), (following - distance * np.cos(after)) / np.sin(after)
    )
    return np.stack((np.broadcast_to(part.wall_angle, distance.shape), distance, half_length), -1)


def wall_centres(part: Part, clearance: npt.ArrayLike, slab_half_thickness: float) -> FloatArray:
    """Return the centres (..., w, 2), m, hole frame, of slabs that lie outside the hole with one face on each wall."""
    return (_wall_distances(part, clearance) + slab_half_thickness)[..., None] * part.wall_normal


def wall_distance(
    part: Part, clearance: npt.ArrayLike, offset: npt.ArrayLike = (0.0, 0.0), yaw: npt.ArrayLike = 0.0
) -> FloatArray:
    """Return the smallest distance (...), m, from the displaced peg's collision outline to a wall; negative if outside.

    Args:
        part: peg and hole.
        clearance: (...) clearance per face, m.
        offset: (..., 2) position of the peg's centre relative to the hole's, hole frame, m.
        yaw: (...) yaw of the peg relative to the hole, rad, seen from above.
    """
    walls = _wall_distances(part, clearance)
    normal = part.wall_normal
    shift = np.asarray(offset, np.float64) @ normal.T
    if part.is_cylinder:
        gap = walls - shift - part.radius_m
        return np.broadcast_to(gap.min(-1), np.broadcast_shapes(gap.shape[:-1], np.shape(yaw)))
    # The normals are turned back by the yaw; the outline stays.
    angle = part.wall_angle - np.asarray(yaw, np.float64)[..., None]
    x, y = part.outline.T
    support = (np.cos(angle)[..., None] * x + np.sin(angle)[..., None] * y).max(-1)
    return (walls - shift - support).min(-1)


def contained(
    part: Part, clearance: npt.ArrayLike, offset: npt.ArrayLike = (0.0, 0.0), yaw: npt.ArrayLike = 0.0
) -> BoolArray:
    """Return whether the displaced peg's outline lies inside the hole, (...); arguments as for `wall_distance`."""
    return wall_distance(part, clearance, offset, yaw) >= 0.0


def yaw_tolerance(part: Part, clearance: npt.ArrayLike) -> FloatArray:
    """Return the angle, rad, by which the centred collision outline can turn to either side before it touches a wall.

    Clearances and result are (...); the result is π if the outline turns freely.
    """
    walls = _wall_distances(part, clearance)
    if part.is_cylinder:
        return np.full(walls.shape[:-1], math.pi)
    x, y = part.outline.T
    radius, direction = np.hypot(x, y), np.arctan2(y, x)
    ahead = np.remainder(part.wall_angle[:, None] - direction, 2.0 * math.pi)
    ratio = walls[..., None] / radius
    contact = np.where(ratio < 1.0, ahead - np.arccos(np.minimum(ratio, 1.0)), math.pi)
    return np.minimum(contact.min((-2, -1)), math.pi)


def _wall_distances(part: Part, clearance: npt.ArrayLike) -> FloatArray:
    return part.wall_reach + np.asarray(clearance, np.float64)[..., None]
