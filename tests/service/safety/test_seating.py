from math import nan

import numpy as np
import pytest

from service.safety.seating import CAMERA, NOMINAL, Finding, Seating, SeatingParameters, judge

PARAMETERS = SeatingParameters(success_depth_m=3e-3, clearance_m=1e-3, tolerance=CAMERA, search_m=15e-3, above_m=45e-3)
HOLE = np.array([0.3, -0.1, 0.08])


def tip(x_mm: float = 0.0, y_mm: float = 0.0, z_mm: float = 0.0) -> np.ndarray:
    """Position relative to the known hole."""
    return HOLE + 1e-3 * np.array([x_mm, y_mm, z_mm])


def contact(z_mm: float) -> float:
    return float(HOLE[2]) + 1e-3 * z_mm


@pytest.mark.parametrize("height_mm", [-2.4, 0.0, 2.4])
def test_a_tip_deep_below_a_contact_where_the_mouth_is_expected_is_seated(height_mm: float) -> None:
    seat = judge(PARAMETERS, HOLE, contact(height_mm), tip(z_mm=height_mm - 3.1))
    assert seat.finding is Finding.SEATED
    assert seat.depth_m == pytest.approx(3.1e-3), "from the contact, not from the estimate"
    assert seat.text == ""
    seat = judge(PARAMETERS, HOLE, contact(height_mm), tip(z_mm=height_mm - 2.9))
    assert (seat.finding, seat.depth_m) == (Finding.NOT_DEEP, pytest.approx(2.9e-3))


@pytest.mark.parametrize("felt", [nan, contact(-2.6), contact(-9.0)])
def test_without_a_contact_there_depth_proves_nothing_yet(felt: float) -> None:
    assert judge(PARAMETERS, HOLE, felt, tip(z_mm=-2.9)).finding is Finding.NOT_DEEP
    seat = judge(PARAMETERS, HOLE, felt, tip(z_mm=-3.1))
    assert seat.finding is Finding.UNPROVEN
    assert seat.depth_m == pytest.approx(3.1e-3)
    assert "3.1 mm below where the hole's mouth is expected" in seat.text


@pytest.mark.parametrize("depth_mm", [-3.0, 0.5, 20.0])
def test_a_contact_far_above_the_mouth_contradicts_the_camera_at_any_depth(depth_mm: float) -> None:
    seat = judge(PARAMETERS, HOLE, contact(2.6), tip(z_mm=2.6 - depth_mm))
    assert seat.finding is Finding.CONTRADICTED
    assert seat.depth_m == pytest.approx(1e-3 * depth_mm)
    assert "2.6 mm above the hole's mouth, tolerance 2.5 mm" in seat.text


def test_at_a_limit_the_finding_is_the_careful_one() -> None:
    origin, height_m, deep = np.zeros(3), CAMERA.height_m, np.array([0.0, 0.0, -20e-3])
    assert judge(PARAMETERS, origin, height_m, deep).finding is Finding.CONTRADICTED
    assert judge(PARAMETERS, origin, -height_m, deep).finding is Finding.UNPROVEN
    assert judge(PARAMETERS, origin, 0.0, np.array([0.0, 0.0, -3e-3])).finding is Finding.NOT_DEEP


def test_a_tip_as_far_beside_the_hole_as_is_possible_is_in_it() -> None:
    seat = judge(PARAMETERS, np.zeros(3), 0.0, np.array([PARAMETERS.seat_m, 0.0, -6e-3]))
    assert seat.finding is Finding.SEATED


@pytest.mark.parametrize("felt", [nan, contact(0.0)])
def test_a_tip_deep_beside_the_hole_is_not_in_it(felt: float) -> None:
    most_mm = 6.0 + 2.0 * 1.0 + 1.5
    assert PARAMETERS.seat_m == pytest.approx(1e-3 * most_mm)
    assert judge(PARAMETERS, HOLE, felt, tip(x_mm=most_mm - 0.1, z_mm=-6.0)).finding is not Finding.CONTRADICTED
    seat = judge(PARAMETERS, HOLE, felt, tip(y_mm=-(most_mm + 0.1), z_mm=-6.0))
    assert seat.finding is Finding.CONTRADICTED
    assert seat.depth_m == pytest.approx(6e-3)
    assert "6.0 mm below the surface, and 9.6 mm beside the hole, where at most 9.5 mm are possible" in seat.text


def test_the_nominal_hole_is_known_less_well_than_the_cameras() -> None:
    nominal = SeatingParameters(3e-3, 1e-3, NOMINAL, 15e-3, 45e-3)
    assert judge(nominal, HOLE, contact(-10.0), tip(x_mm=14.0, z_mm=-13.1)).finding is Finding.SEATED
    assert judge(nominal, HOLE, nan, tip(z_mm=-14.9)).finding is Finding.NOT_DEEP
    assert judge(nominal, HOLE, nan, tip(z_mm=-15.1)).finding is Finding.UNPROVEN


@pytest.mark.parametrize(
    ("where", "why"),
    [
        (tip(x_mm=24.4), None),
        (tip(x_mm=24.6), "24.6 mm beside the hole, limit 24.5 mm"),
        (tip(x_mm=-18.0, y_mm=18.0), "25.5 mm beside the hole"),
        (tip(z_mm=44.9), None),
        (tip(z_mm=45.1), "45.1 mm above the hole, limit 45.0 mm"),
        (tip(z_mm=-60.0), None),
        (tip(x_mm=nan), "nan mm beside"),
        (tip(z_mm=nan), "nan mm above"),
    ],
)
def test_a_run_stays_about_its_hole(where: np.ndarray, why: str | None) -> None:
    text = PARAMETERS.why_stray(HOLE, where)
    assert (text is None) if why is None else (why in text)


def test_a_tip_at_the_limits_of_the_room_has_not_strayed() -> None:
    hole = np.zeros(3)
    assert PARAMETERS.why_stray(hole, np.array([PARAMETERS.room_m, 0.0, PARAMETERS.above_m])) is None


def test_a_finding_counts_after_two_steps_in_a_row() -> None:
    seating = Seating(PARAMETERS)
    deep, shallow = tip(z_mm=-3.5), tip(z_mm=-2.0)
    settled = [seating.observe(HOLE, contact(0.0), where)[1] for where in (deep, shallow, deep, deep, deep)]
    assert settled == [False, False, False, True, True]


def test_the_last_of_two_findings_counts() -> None:
    seating = Seating(PARAMETERS)
    assert seating.observe(HOLE, nan, tip(z_mm=-3.5))[1] is False
    seat, settled = seating.observe(HOLE, contact(-0.5), tip(z_mm=-4.0))
    assert (seat.finding, settled) == (Finding.SEATED, True)


@pytest.mark.parametrize("field", ["success_depth_m", "clearance_m", "search_m", "above_m"])
@pytest.mark.parametrize("bad", [0.0, -1.0, nan, float("inf")])
def test_requirements_that_everything_or_nothing_meets_are_refused(field: str, bad: float) -> None:
    good = {"success_depth_m": 3e-3, "clearance_m": 1e-3, "search_m": 15e-3, "above_m": 45e-3}
    with pytest.raises(ValueError, match=rf"seating\.{field}"):
        SeatingParameters(tolerance=CAMERA, **(good | {field: bad}))
