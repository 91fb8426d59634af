import pickle
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_backend.world import parts
from sim_backend.world.parts import PARTS, contained, hole_walls, proportion, wall_centres, wall_distance, yaw_tolerance
from wire import task

LARGE, SMALL = 4e-3 / 3, 1e-3 / 3
NAMES = st.sampled_from(sorted(PARTS))
CLEARANCES = st.floats(0.05e-3, 6e-3)
each_part = pytest.mark.parametrize("part", PARTS.values(), ids=PARTS)


def corners(part, clearance):
    """Corners of the hole, from the intersection of neighbouring walls."""
    angle, distance, _ = hole_walls(part, clearance).T
    normal = np.stack((np.cos(angle), np.sin(angle)), -1)
    pairs = np.stack((normal, np.roll(normal, -1, 0)), 1)
    return np.linalg.solve(pairs, np.stack((distance, np.roll(distance, -1)), -1)[..., None])[..., 0]


def area(polygon):
    x, y = polygon.T
    return 0.5 * (x * np.roll(y, -1) - y * np.roll(x, -1)).sum()


def table():
    assert parts.__doc__ is not None
    rows = [row.strip("| ").split(" | ") for row in parts.__doc__.splitlines() if row.startswith("| ")]
    return [
        (name, size, {"4/3": LARGE, "1/3": SMALL}[c], float(own), float(paper))
        for name, size, c, own, paper in rows[1:]
    ]


def test_the_parts_are_those_that_a_task_can_name():
    assert tuple(PARTS) == get_args(task.Part)


@pytest.mark.parametrize(("name", "size", "clearance", "own", "paper"), table())
def test_the_table_states_size_and_proportion_as_computed_and_near_the_paper(name, size, clearance, own, paper):
    part = PARTS[name]
    assert size.split()[1:] == [f"{part.size_m * 1e3:.1f}", "mm"]
    assert own == pytest.approx(100 * proportion(part, clearance), abs=0.005 + 1e-9)
    assert own == pytest.approx(paper, abs=0.05)


@pytest.mark.parametrize("name", ["rtr", "trm", "cir", "b-rtr"])
def test_no_other_tenth_of_a_millimetre_comes_closer_to_the_paper(name):
    build = {"rtr": parts._reuleaux, "b-rtr": parts._reuleaux, "trm": parts._cut_triangle, "cir": parts._circle}[name]
    _, _, clearance, _, paper = next(row for row in table() if row[0] == name)
    misses = [
        abs(100 * proportion(build(name, PARTS[name].size_m + step * 1e-4), clearance) - paper) for step in (-1, 0, 1)
    ]
    assert np.argmin(misses) == 1


@each_part
@pytest.mark.parametrize("clearance", [SMALL, LARGE])
def test_the_walls_enclose_the_true_hole_up_to_the_facets(part, clearance):
    true = part.area_m2 / (1 - proportion(part, clearance))
    assert true <= area(corners(part, clearance)) * (1 + 1e-12)
    assert true == pytest.approx(area(corners(part, clearance)), rel={"straight": 1e-12}.get(part.face, 0.011))


def test_the_true_hole_of_a_reuleaux_triangle_is_three_discs_about_its_corners():
    part, clearance = PARTS["rtr"], LARGE
    centres = part.outline[np.hypot(*part.outline.T) > part.radius_m - 1e-9]
    assert centres.shape == (3, 2)
    grid = np.linspace(-0.02, 0.02, 1501)
    inside = np.ones((1501, 1501), bool)
    for x, y in centres:
        inside &= (grid[:, None] - x) ** 2 + (grid - y) ** 2 <= (part.size_m + clearance) ** 2
    counted = inside.sum() * (grid[1] - grid[0]) ** 2
    assert proportion(part, clearance) == pytest.approx(1 - part.area_m2 / counted, abs=1e-4)


@each_part
def test_outlines_are_convex_counter_clockwise_mirrored_and_of_the_stated_area(part):
    edges = np.roll(part.outline, -1, 0) - part.outline
    following = np.roll(edges, -1, 0)
    assert (edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0] > 0).all()
    mirrored = part.outline * [1, -1]
    assert (np.hypot(*(part.outline[:, None] - mirrored).T).min(0) < 1e-12).all()
    assert area(part.outline) == pytest.approx(part.area_m2, rel={"straight": 1e-12}.get(part.face, 0.021))
    with pytest.raises(ValueError, match="read-only"):
        part.outline[0] = 0


@each_part
def test_a_turn_by_the_symmetry_maps_the_outline_onto_itself(part):
    turn = 2 * np.pi / (part.symmetry_order or 18)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    turned = part.outline @ rotation.T
    assert (np.hypot(*(part.outline[:, None] - turned).T).min(0) < 1e-12).all()


@each_part
@pytest.mark.parametrize("clearance", [0.1e-3, SMALL, 2e-3, 6e-3])
def test_a_centred_peg_is_the_clearance_away_from_every_wall(part, clearance):
    angle, distance, _ = hole_walls(part, clearance).T
    normal = np.stack((np.cos(angle), np.sin(angle)))
    support = part.radius_m if part.is_cylinder else (part.outline @ normal).max(0)
    assert distance - support == pytest.approx(np.full(len(distance), clearance), abs=1e-15)
    assert wall_distance(part, clearance) == pytest.approx(clearance, abs=1e-15)


@given(NAMES, CLEARANCES)
def test_every_wall_has_a_face_and_reaches_its_neighbours_but_no_further(name, clearance):
    part = PARTS[name]
    tips = corners(part, clearance)
    assert area(tips) > part.area_m2
    assert wall_distance(part, clearance) > 0
    angle, distance, half_length = hole_walls(part, clearance).T
    along = np.stack((-np.sin(angle), np.cos(angle)), -1)
    start, end = (np.roll(tips, 1, 0) * along).sum(-1), (tips * along).sum(-1)
    assert (end > start).all()
    assert half_length == pytest.approx(np.maximum(-start, end), abs=1e-12)
    inside = tips @ np.stack((np.cos(angle), np.sin(angle))) - distance
    assert inside.max() < 1e-12  # no wall cuts into the hole of the others


@each_part
def test_slabs_have_their_inner_face_on_the_wall_for_every_clearance_of_a_batch(part):
    clearance = np.array([[SMALL, LARGE, 2e-3]])
    centres = wall_centres(part, clearance, 0.01)
    walls = hole_walls(part, clearance)
    assert centres.shape == (1, 3, len(part.wall_angle), 2)
    assert (centres * part.wall_normal).sum(-1) - 0.01 == pytest.approx(walls[..., 1], abs=1e-15)
    assert np.array_equal(walls[0, 1], hole_walls(part, LARGE))


@given(NAMES, CLEARANCES, st.floats(0, 6.3), st.floats(0, 1.5), st.floats(-1.2, 1.2))
def test_a_peg_is_inside_exactly_when_all_of_its_outline_is(name, clearance, direction, shift, yaw):
    part = PARTS[name]
    offset = shift * clearance * np.array([np.cos(direction), np.sin(direction)])
    c, s = np.cos(yaw), np.sin(yaw)
    if part.is_cylinder:
        around = np.linspace(0, 2 * np.pi, 3601)
        outline = part.radius_m * np.stack((np.cos(around), np.sin(around)), -1)
    else:
        outline = part.outline
    points = outline @ np.array([[c, -s], [s, c]]).T + offset
    angle, distance, _ = hole_walls(part, clearance).T
    nearest = (distance - points @ np.stack((np.cos(angle), np.sin(angle)))).min()
    assert wall_distance(part, clearance, offset, yaw) == pytest.approx(nearest, abs=1e-8)
    if abs(nearest) > 1e-8:
        assert contained(part, clearance, offset, yaw) == (nearest > 0)


@given(NAMES, CLEARANCES, st.floats(0, 6.3), st.floats(0, 0.999))
def test_an_aligned_peg_fits_within_the_clearance_in_every_direction(name, clearance, direction, shift):
    offset = shift * clearance * np.array([np.cos(direction), np.sin(direction)])
    assert contained(PARTS[name], clearance, offset)


@each_part
def test_pushed_against_a_wall_the_peg_goes_no_further_than_the_clearance(part):
    for normal in part.wall_normal:
        assert contained(part, SMALL, 0.999 * SMALL * normal)
        assert not contained(part, SMALL, 1.001 * SMALL * normal)


@given(NAMES, CLEARANCES)
def test_a_centred_peg_turns_by_the_yaw_tolerance_either_way_and_no_further(name, clearance):
    part = PARTS[name]
    tolerance = float(yaw_tolerance(part, clearance))
    turns = np.linspace(-0.999 * tolerance, 0.999 * tolerance, 101)
    assert contained(part, clearance, yaw=turns).all()
    if tolerance < np.pi:
        assert not contained(part, clearance, yaw=[-tolerance - 1e-6, tolerance + 1e-6]).any()


@pytest.mark.parametrize(("clearance", "degrees"), [(SMALL, 1.37), (LARGE, 5.63), (2e-3, 8.59)])
def test_the_triangle_turns_by_what_its_geometry_allows(clearance, degrees):
    tolerance = yaw_tolerance(PARTS["tr"], clearance)
    assert np.degrees(tolerance) == pytest.approx(degrees, abs=0.01)
    inradius = 28e-3 / np.sqrt(12)
    assert tolerance == pytest.approx(np.pi / 3 - np.arccos((inradius + clearance) / (2 * inradius)))


@pytest.mark.parametrize(("name", "clearance"), [("rtr", LARGE), ("rtr", SMALL), ("b-rtr", SMALL)])
def test_facets_change_the_yaw_tolerance_of_a_reuleaux_peg_by_less_than_a_degree(name, clearance):
    width = PARTS[name].size_m
    true = 2 * np.arcsin(np.sqrt(0.75) * (1 + clearance / width)) - np.radians(120)
    assert true < yaw_tolerance(PARTS[name], clearance) < true + np.radians(1.0)


def test_a_cylinder_turns_freely():
    assert yaw_tolerance(PARTS["cir"], SMALL) == np.pi
    assert contained(PARTS["cir"], SMALL, yaw=np.linspace(0, 6, 50)).all()


@each_part
@pytest.mark.parametrize("batch", [(), (4,), (2, 3), (0,)])
def test_every_function_keeps_the_batch_shape(part, batch):
    clearance = np.full(batch, SMALL)
    assert proportion(part, clearance).shape == batch
    assert yaw_tolerance(part, clearance).shape == batch
    assert hole_walls(part, clearance).shape == (*batch, len(part.wall_angle), 3)
    assert wall_distance(part, clearance, np.zeros((*batch, 2)), np.zeros(batch)).shape == batch
    assert wall_distance(part, SMALL, np.zeros(2), np.zeros(batch)).shape == batch
    assert contained(part, SMALL, np.zeros((*batch, 2)), 0.0).shape == batch


def test_a_part_crosses_to_another_process():
    for part in PARTS.values():
        copy = pickle.loads(pickle.dumps(part))  # noqa: S301 - our own bytes
        assert np.array_equal(copy.outline, part.outline)
