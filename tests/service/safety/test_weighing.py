"""A payload of known weight, turned in front of a sensor that lies in every constant way."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from service.safety.weighing import MIN_TURN_RAD, POINTING, Payload, Rest, Scale, Weighing
from service.testing.lying_sensor import LIES
from wire.pose import rotation_from_rotvec

PAYLOAD = Payload(0.93, (0.0, 0.0, 0.0585))
SCALE = Scale(PAYLOAD, 30.0, 10.0)
BIAS = np.array([2.0, -4.7, 1.0, 0.1, -0.1, 0.05])
DOWN, X, Y, BACK = (np.array(POINTING[name]) for name in ("z", "x", "y", "-x"))
FOUR = (DOWN, X, Y, BACK)
WEIGHT_N = 0.93 * 9.81

Sensor = Callable[[np.ndarray], np.ndarray]


def honest(load: np.ndarray) -> np.ndarray:
    return load


def lying(name: str) -> Sensor:
    return lambda load: LIES[name](load, np.zeros(6))


def gains(*factors: float) -> Sensor:
    return lambda load: load * factors


def turned(degrees: float, *axis: float) -> Sensor:
    rotation = rotation_from_rotvec(np.deg2rad(degrees) * np.array(axis))
    return lambda load: np.concatenate((rotation @ load[:3], rotation @ load[3:]))


def rest(
    down: np.ndarray,
    sensor: Sensor = honest,
    *,
    carried: Payload = PAYLOAD,
    scale: Scale = SCALE,
    touch_n: tuple[float, float, float] = (0.0, 0.0, 0.0),
    quantum: tuple[float, float] = (0.1, 0.005),
) -> Rest:
    """One attitude: bias, noise and resolution, the lie underneath, and a sensor whose range ends."""
    rng = np.random.default_rng(int(1e6 * abs(down[0] + 2.0 * down[1] + 3.0 * down[2])))
    force = carried.mass_kg * 9.81 * down
    load = np.concatenate((force + touch_n, np.cross(carried.centre_m, force)))
    resolution = np.repeat(quantum, 3)
    noisy = load + BIAS + rng.normal(size=(200, 6)) * ([0.7] * 3 + [0.05] * 3)
    told = np.array([sensor(reading) for reading in resolution * np.round(noisy / resolution)])
    window = np.clip(told, [-30.0] * 3 + [-10.0] * 3, [30.0] * 3 + [10.0] * 3)
    return Rest.of(scale, window, down, carried.mass_kg)


def weighed(sensor: Sensor = honest, downs: tuple[np.ndarray, ...] = FOUR, **details) -> Weighing:
    return Weighing(details.get("scale", SCALE), tuple(rest(down, sensor, **details) for down in downs))


def cone(degrees: float, count: int) -> tuple[np.ndarray, ...]:
    """Straight down, and `count` attitudes around it."""
    tilt, around = np.deg2rad(degrees), np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    return (DOWN, *(np.array([np.sin(tilt) * np.cos(a), np.sin(tilt) * np.sin(a), np.cos(tilt)]) for a in around))


def only(weighing: Weighing) -> str:
    (finding,) = weighing.findings
    return finding


def test_the_weight_of_a_payload_is_mass_times_gravity_at_its_centre() -> None:
    payload = Payload(2.0, (0.1, 0.2, 0.3))
    force, torque = payload.load(X)
    assert payload.weight_n == pytest.approx(19.62)
    assert force == pytest.approx([19.62, 0.0, 0.0])
    assert torque == pytest.approx([0.0, 0.3 * 19.62, -0.2 * 19.62])


@pytest.mark.parametrize("centre", [(0.0, 0.0, 0.0585), (0.03, -0.02, 0.08)])
@pytest.mark.parametrize("downs", [FOUR, cone(70.0, 3), cone(90.0, 5), (*FOUR, -Y, -DOWN)])
def test_an_honest_sensor_passes_whatever_its_bias_noise_and_resolution(downs, centre) -> None:
    payload = Payload(0.93, centre)
    weighing = weighed(downs=downs, carried=payload, scale=replace(SCALE, payload=payload))
    assert weighing.passed
    assert weighing.forces_are_right
    assert weighing.findings == ()
    assert weighing.proven == (True, True, True)
    assert weighing.gain == pytest.approx(np.eye(3), abs=0.05)
    assert weighing.mass_kg == pytest.approx(0.93, abs=0.02)
    assert weighing.joints_kg == pytest.approx(0.93)
    assert weighing.centre_m == pytest.approx(centre, abs=3e-3)
    assert np.abs(weighing.residuals[:, :3]).max() < 0.2
    assert np.abs(weighing.residuals[:, 3:]).max() < 0.02


@pytest.mark.parametrize(
    ("lie", "findings"),
    {
        **{f"{name} frozen": [f"{name} frozen"] for name in ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")},
        "forces frozen": ["Fx, Fy, Fz frozen"],
        "torques frozen": ["Tx, Ty, Tz frozen"],
        **{f"sign of {name}": [f"{name} with the wrong sign"] for name in ("Fx", "Fy", "Fz")},
        "sign of forces": ["Fx, Fy, Fz with the wrong sign"],
        "sign of all": ["Fx, Fy, Fz with the wrong sign"],
        "gain 0.2": ["gain 0.20 on all axes"],
        "gain 0.5": ["gain 0.50 on all axes"],
        "gain 0.67": ["gain 0.67 on all axes"],
        "gain 2": ["gain 2.00 on all axes"],
        "gain 5": ["Fx, Fy, Fz at the end of the sensor's range"],
        "x and y swapped": ["x and y are swapped"],
        "x and z swapped": ["x and z are swapped"],
    }.items(),
)
def test_66_67_every_constant_lie_is_named_with_its_remedy(lie: str, findings: list[str]) -> None:
    weighing = weighed(lying(lie))
    assert weighing.complete
    assert not weighing.passed
    assert not weighing.forces_are_right
    assert len(weighing.findings) == len(findings)
    assert all(found.startswith(wanted) for found, wanted in zip(weighing.findings, findings, strict=True))
    assert all(": " in found and len(found.partition(": ")[2]) > 20 for found in weighing.findings)


def test_no_constant_lie_is_missing_from_these_tests() -> None:
    passed = [name for name in LIES if weighed(lying(name)).passed]
    assert passed == []


@pytest.mark.parametrize("downs", [FOUR[:1], FOUR[:2], FOUR[:3], cone(20.0, 6), cone(90.0, 2)])
def test_too_few_or_too_similar_attitudes_prove_nothing_and_accuse_nobody(downs: tuple[np.ndarray, ...]) -> None:
    weighing = weighed(lying("sign of Fx"), downs)
    assert not weighing.complete
    assert not weighing.passed
    assert not weighing.forces_are_right
    assert weighing.findings == ()


def test_an_axis_that_was_not_shown_the_weight_is_not_proven() -> None:
    along_x = (DOWN, X, BACK, (X + DOWN) / np.sqrt(2.0))
    assert weighed(downs=along_x).proven == (True, False, True)
    slightly = cone(55.0, 4)
    assert weighed(downs=slightly).proven == (True, True, False)
    assert weighed(downs=slightly).shown_n[2] == pytest.approx(WEIGHT_N * (1 - np.cos(np.deg2rad(55.0))) * 0.8**0.5)


def test_what_three_attitudes_show_a_bias_may_have_made() -> None:
    assert weighed(downs=FOUR[:3]).shown_n == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


def test_a_broken_channel_is_named_at_the_first_attitude() -> None:
    assert only(weighed(lying("Fx frozen"), (DOWN,))).startswith("Fx frozen, without a change by a bit in 200 samples")
    assert only(weighed(lying("gain 5"), (DOWN,))).startswith("Fy, Fz at the end of the sensor's range")


@pytest.mark.parametrize("channel", range(6))
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_any_channel_that_is_not_a_number_is_at_the_end_of_its_range(channel: int, value: float) -> None:
    window = np.random.default_rng(0).normal(size=(10, 6))
    window[3, channel] = value
    taken = Rest.of(SCALE, window, DOWN, 0.93)
    assert np.flatnonzero(taken.saturated).tolist() == [channel]
    assert taken.wrench[channel] == 0.0
    name = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")[channel]
    assert only(Weighing(SCALE, (taken,))).startswith(f"{name} at the end")


def test_a_channel_that_is_not_a_number_does_not_hide_what_is_wrong_with_the_others() -> None:
    def broken(load: np.ndarray) -> np.ndarray:
        return np.array([np.nan, load[1], -load[2], *load[3:]])

    found = [sentence.partition(":")[0] for sentence in weighed(broken).findings]
    assert found == ["Fx at the end of the sensor's range", "Fz with the wrong sign"]


@pytest.mark.parametrize(("channel", "end"), [(0, 30.0), (2, 30.0), (3, 10.0), (5, 10.0)])
def test_the_range_of_a_channel_ends_at_its_end(channel: int, end: float) -> None:
    window = np.random.default_rng(0).normal(size=(10, 6))
    for value, is_saturated in ((end - 1e-6, False), (end, True), (-end, True)):
        window[3, channel] = value
        assert Rest.of(SCALE, window, DOWN, 0.93).saturated[channel] == is_saturated


def test_a_mean_is_that_of_the_window_and_a_channel_that_moves_once_is_not_frozen() -> None:
    window = np.ones((4, 6))
    window[2, 1] = 3.0
    taken = Rest.of(SCALE, window, DOWN, 0.9)
    assert taken.wrench.tolist() == [1.0, 1.5, 1.0, 1.0, 1.0, 1.0]
    assert taken.frozen.tolist() == [True, False, True, True, True, True]
    assert (taken.samples, taken.joints_kg) == (4, 0.9)


@pytest.mark.parametrize("row", range(3))
def test_a_gain_that_is_not_one_of_a_single_channel_is_named(row: int) -> None:
    factors = np.ones(6)
    factors[row] = 0.6
    assert only(weighed(gains(*factors))).startswith(f"{('Fx', 'Fy', 'Fz')[row]} with a gain of 0.60")


def test_gains_that_differ_are_told_apart() -> None:
    found = weighed(gains(0.5, 0.7, 0.6, 1.0, 1.0, 1.0)).findings
    assert [sentence.partition(":")[0] for sentence in found] == [
        "Fx with a gain of 0.50",
        "Fy with a gain of 0.70",
        "Fz with a gain of 0.60",
    ]


@pytest.mark.parametrize(("gain", "passes"), [(0.78, False), (0.82, True), (1.22, True), (1.28, False)])
def test_a_gain_passes_within_its_limits(gain: float, passes: bool) -> None:
    assert weighed(gains(1.0, 1.0, gain, 1.0, 1.0, 1.0)).passed is passes


@pytest.mark.parametrize(
    ("gain", "shared", "shown"),
    [(0.9, -0.15, r"0\.5\d"), (1.1, 0.18, r"1\.4\d"), (1.0, 0.02, None)],
    ids=["too little", "too much", "right"],
)
def test_a_force_between_channels_that_are_not_at_right_angles_is_named(
    gain: float, shared: float, shown: str | None
) -> None:
    """Each channel has a right gain and little of the other axes; a force along all three axes is what is wrong."""
    mixed = np.eye(6)
    mixed[:3, :3] = shared
    mixed[range(3), range(3)] = np.sqrt(gain**2 - 2.0 * shared**2)
    light = Payload(0.4, PAYLOAD.centre_m)
    downs = (*FOUR, -Y, -DOWN)
    weighing = weighed(lambda load: mixed @ load, downs, carried=light, scale=Scale(light, 30.0, 10.0))
    assert weighing.complete
    if shown is None:
        assert weighing.passed
    else:
        along = r"\[(-?0\.[56]\d(, )?){3}\]"
        assert re.match(f"a force along {along} of the flange is shown with a gain of {shown}: ", only(weighing))


def test_a_wrong_payload_and_a_wrong_scale_are_told_as_one_question_with_what_the_joints_feel() -> None:
    heavier = Payload(1.86, PAYLOAD.centre_m)
    found = only(weighed(carried=heavier))
    assert found.startswith("gain 2.00 on all axes: the sensor weighs 1.86 kg, the joints about 1.86 kg, 0.93 kg")
    assert "the joints about 0.93 kg" in only(weighed(gains(*[2.0] * 6)))
    assert "Weigh the payload on a scale" in found, "a mass taken from this sensor would prove its gain by itself"


def test_a_channel_that_shows_nothing_but_noise_is_not_connected() -> None:
    for row, name in enumerate(("Fx", "Fy", "Fz")):
        dead = lambda load, row=row: np.where(np.arange(6) == row, load - load.round(), load)  # noqa: E731
        assert only(weighed(dead)).startswith(f"{name} does not show the payload's weight")


def test_axes_in_another_order_and_turned_over_are_named_each() -> None:
    def around(load: np.ndarray) -> np.ndarray:
        fx, fy, fz = load[:3]
        return np.array([fy, -fz, fx, *load[3:]])

    found = [sentence.partition(":")[0] for sentence in weighed(around).findings]
    assert found == [
        "Fx shows the weight along y",
        "Fy shows the weight along z",
        "Fz shows the weight along x",
        "Fy with the wrong sign",
    ]


def test_two_channels_that_show_one_axis_are_not_swapped() -> None:
    def doubled(load: np.ndarray) -> np.ndarray:
        return np.array([load[0], load[0], *load[2:]])

    assert only(weighed(doubled)).startswith("Fy shows the weight along x")


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)])
def test_a_sensor_that_is_turned_against_the_flange_is_named(axis: tuple[float, float, float]) -> None:
    assert weighed(turned(8.0, *axis)).passed
    found = weighed(turned(30.0, *axis)).findings
    assert len(found) == 2, "the two channels about the axis"
    assert all("the sensor is turned against the flange" in sentence for sentence in found)
    assert all("0.8" in sentence and ("0.5" in sentence or "0.4" in sentence) for sentence in found)


@pytest.mark.parametrize(
    ("degrees", "gain", "is_turned"), [(10, 2.0, False), (20, 2.0, True), (10, 0.5, False), (20, 0.5, True)]
)
def test_a_turn_is_judged_whatever_the_gain(degrees: float, gain: float, is_turned: bool) -> None:
    sensor = turned(degrees, 0.0, 0.0, 1.0)
    found = weighed(lambda load: gain * sensor(load)).findings
    assert any("the sensor is turned" in sentence for sentence in found) is is_turned
    assert any("gain" in sentence for sentence in found)


def test_a_touch_at_one_attitude_of_many_is_named_by_its_number() -> None:
    downs = (DOWN, X, Y, BACK, -Y, DOWN, X, Y, BACK, -Y)
    rests = [rest(down) for down in downs]
    rests[4] = rest(downs[4], touch_n=(0.0, 0.0, 2.6))
    found = only(Weighing(SCALE, tuple(rests)))
    assert found.startswith("attitude 5 is 2.")
    assert "limit 2 N" in found


def test_a_heavy_payload_that_is_off_by_an_eighth_is_weighed_in_newtons() -> None:
    configured, carried = Payload(2.0, PAYLOAD.centre_m), Payload(2.25, PAYLOAD.centre_m)
    scale = Scale(configured, 50.0, 10.0)
    assert weighed(carried=carried, scale=scale).passed, "2.5 N of 3.3 N"
    scale = Scale(configured, 30.0, 10.0)
    found = weighed(carried=carried, scale=scale).findings
    assert found
    assert all("the sensor weighs 2.25 kg, 2 kg is configured" in sentence for sentence in found)


def test_a_centre_that_is_configured_wrongly_is_found_by_the_torques() -> None:
    found = only(weighed(carried=Payload(0.93, (0.0, 0.04, 0.0585))))
    assert "lies at [" in found
    assert "40, 5" in found
    assert "[0, 0, 58] mm is configured" in found


def test_a_centre_far_off_is_found_by_the_torques_and_not_by_the_forces() -> None:
    assert only(weighed(carried=Payload(0.93, (0.0, 0.3, 0.0585)))).startswith("by the torques the payload's centre")


def test_a_small_error_of_every_torque_does_not_hide_a_wrong_centre() -> None:
    def inexact(load: np.ndarray) -> np.ndarray:
        return load + np.concatenate((np.zeros(3), 0.015 * load[:3]))

    found = only(weighed(inexact, carried=Payload(0.93, (0.0, 0.04, 0.0585))))
    assert found.startswith("by the torques the payload's centre")


def test_torques_that_are_all_turned_over_look_like_a_centre_on_the_other_side() -> None:
    assert "the torques have a wrong sign or gain" in only(weighed(gains(1, 1, 1, -1, -1, -1)))


@pytest.mark.parametrize("row", range(2))
def test_a_sign_of_a_single_torque_is_named(row: int) -> None:
    factors = np.ones(6)
    factors[3 + row] = -1.0
    found = only(weighed(gains(*factors)))
    assert found.startswith(f"{('Tx', 'Ty')[row]} differs from the torque of the payload's weight by up to 1.0")
    assert "(gain -1.0" in found or "(gain -0.9" in found


def test_a_torque_about_an_axis_without_a_lever_is_named_where_it_shows_the_weight() -> None:
    def leaking(load: np.ndarray) -> np.ndarray:
        return load + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.05 * load[0]])

    assert only(weighed(leaking)).startswith("Tz differs from the torque of the payload's weight by up to 0.4")


def test_torques_whose_lever_is_too_short_are_not_proven() -> None:
    assert weighed().unproven_torques == ("Tz",)
    assert weighed(scale=Scale(Payload(0.93, (0.1, 0.0, 0.0)), 30.0, 10.0)).unproven_torques == ("Tx",)
    assert weighed(scale=Scale(Payload(0.93, (0.0, 0.0, 0.01)), 30.0, 10.0)).unproven_torques == ("Tx", "Ty", "Tz")


@pytest.mark.parametrize(("kg", "range_n", "too_light"), [(0.28, 30, True), (0.3, 30, False), (0.3, 50, True)])
def test_a_payload_that_proves_no_axis_is_too_light(kg: float, range_n: float, too_light: bool) -> None:
    scale = Scale(Payload(kg, (0.0, 0.0, 0.05)), range_n, 10.0)
    six = (DOWN, X, Y, BACK, -Y, -DOWN)
    assert scale.is_too_light is too_light
    assert weighed(downs=six, scale=scale, carried=scale.payload).complete is not too_light


def test_the_limits_are_shares_of_the_sensor_s_range() -> None:
    assert (SCALE.limit_n, SCALE.limit_nm, SCALE.needed_n) == pytest.approx((2.0, 0.2, 4.0))


def test_the_attitudes_that_are_proposed_prove_every_axis() -> None:
    downs, proposed = (DOWN,), []
    while not (weighing := weighed(downs=downs)).complete:
        proposed.append(weighing.next_axis())
        downs = (*downs, np.array(POINTING[proposed[-1]]))
    assert proposed == ["x", "y", "-x"]


def test_a_tool_that_points_upwards_is_proposed_last() -> None:
    downs = (DOWN, X, Y, BACK)
    assert weighed(downs=downs).next_axis() == "-y"
    assert weighed(downs=(*downs, -Y)).next_axis() == "-z"
    nearly = np.array([0.0, -np.cos(0.36), np.sin(0.36)])
    assert weighed(downs=(*downs, nearly)).next_axis() == "-y", "more than 20° away"
    assert weighed(downs=(X,)).next_axis() == "-x"


def test_an_attitude_is_as_far_as_the_nearest_one_taken() -> None:
    weighing = weighed(downs=(DOWN, X))
    assert weighing.turned_rad(DOWN) == pytest.approx(0.0, abs=1e-7)
    assert weighing.turned_rad(np.array([np.sin(0.4), 0.0, np.cos(0.4)])) == pytest.approx(0.4)
    assert weighing.turned_rad(np.array([np.cos(0.3), np.sin(0.3), 0.0])) == pytest.approx(0.3)
    assert weighing.turned_rad(Y) == pytest.approx(np.pi / 2)
    assert weighing.turned_rad(1.001 * DOWN) == 0.0, "rounding"
    assert weighed(downs=(DOWN,)).turned_rad(-1.001 * DOWN) == pytest.approx(np.pi)
    assert pytest.approx(np.deg2rad(20.0)) == MIN_TURN_RAD
