"""The shape of a peg that was not made to size: chamfered, rounded, oversize or tapered."""

from dataclasses import dataclass

import numpy as np

from sim_backend.world.parts import Part
from wire.arrays import FloatArray
from wire.plant import PlantErrors

_ARC = 5
"""Points of a rounded edge."""
_FACETS = 72
"""Faces of a round peg with an error; between them it is thinner by 17 µm. Without errors it is a true cylinder."""
_SHARP = np.cos(np.deg2rad(20))
"""Cosine of the turn between two faces from which on their edge can be rounded; a curved face has no edges."""


@dataclass(frozen=True, slots=True)
class PegShape:
    """Errors of a peg's shape; the fields are those of `PlantErrors`."""

    chamfer_m: float = 0.0
    rounding_m: float = 0.0
    oversize_m: float = 0.0
    taper_deg: float = 0.0


EXACT = PegShape()


def shape_of(plant: PlantErrors | None) -> PegShape:
    """Return the shape of a plant's peg."""
    if plant is None:
        return EXACT
    return PegShape(plant.peg_chamfer_m, plant.peg_rounding_m, plant.peg_oversize_m, plant.peg_taper_deg)


def vertices(part: Part, shape: PegShape) -> FloatArray:
    """Return the vertices (k, 3) of a peg's convex hull, part frame seen from above, z down from its bottom at 0, m."""
    outline = part.outline
    if shape == EXACT:
        rings = [(outline, 0.0), (outline, -part.peg_height_m)]
    else:
        if part.is_cylinder:
            angle = np.arange(_FACETS) * (2.0 * np.pi / _FACETS)
            outline = part.radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
        outline = offset(outline, shape.oversize_m)
        wider = part.peg_height_m * np.tan(np.deg2rad(shape.taper_deg))
        chamfer, rounding = shape.chamfer_m, shape.rounding_m
        rings = [
            (_rounded(offset(outline, -chamfer), max(rounding - chamfer, 0.0)), 0.0),
            (_rounded(outline, rounding), -chamfer),
            (_rounded(offset(outline, wider), rounding), -part.peg_height_m),
        ]
    return np.concatenate([np.column_stack([ring, np.full(len(ring), z)]) for ring, z in rings])


def offset(outline: FloatArray, distance: float) -> FloatArray:
    """Move every face of a convex outline (k, 2), counter-clockwise, outwards by a distance; return its corners."""
    before, after = _normals(outline)
    return outline + distance * (before + after) / (1.0 + (before * after).sum(1, keepdims=True))


def _rounded(outline: FloatArray, radius: float) -> FloatArray:
    """Replace the sharp corners of an outline by arcs that touch both faces."""
    before, after = _normals(outline)
    sharp = (before * after).sum(1) < _SHARP
    centres = offset(outline, -radius)
    points: list[FloatArray] = []
    for corner, centre, is_sharp, first, last in zip(outline, centres, sharp, before, after, strict=True):
        if not is_sharp or radius == 0.0:
            points.append(corner[None])
            continue
        share = np.linspace(0.0, 1.0, _ARC)[:, None]
        angle = np.arccos(np.clip(first @ last, -1.0, 1.0))
        arc = (np.sin((1.0 - share) * angle) * first + np.sin(share * angle) * last) / np.sin(angle)
        points.append(centre + radius * arc)
    return np.concatenate(points)


def _normals(outline: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the outward normals (k, 2) of the faces before and after each corner."""
    along = np.roll(outline, -1, 0) - outline
    normal = np.column_stack([along[:, 1], -along[:, 0]]) / np.sqrt((along * along).sum(1))[:, None]
    return np.roll(normal, 1, 0), normal
