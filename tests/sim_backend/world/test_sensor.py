import dataclasses

import numpy as np
import pytest

from sim_backend.world.conditions import draw
from sim_backend.world.sensor import RANGE, ZERO_TICKS, ForceTorqueSensor
from wire import pose
from wire.records import TICK_S
from wire.task import Task

MASS, COM, TCP = 0.93, 0.06, 0.19
DOWN = pose.tool_down(np.zeros(1))


def episode(**changes):
    quiet = {"wrench_noise": np.zeros((4096, 6), np.float32), "bias": np.zeros(6), "drift": np.zeros(6)}
    return dataclasses.replace(draw(Task(0)), **{**quiet, "sensor_delay": 1, **changes})


def sensor(n=1, **changes):
    made = ForceTorqueSensor(n, MASS, (0, 0, COM), (0, 0, TCP))
    for cell in range(n):
        made.reset(cell, episode(**changes))
    return made


def weight(rotation, mass=MASS, com=COM):
    """Load on the flange at rest, flange axes."""
    force = rotation.swapaxes(-1, -2) @ np.array([0.0, 0.0, -mass * 9.81])
    return np.concatenate([force, np.cross([0.0, 0.0, com], force)], axis=-1)


def contact(rotation, force, moment, lever):
    """Load on the flange of a wrench (base axes) at a point `lever` (base axes) from the flange's origin."""
    turned = rotation.swapaxes(-1, -2)
    return np.concatenate(
        [(turned @ force[..., None])[..., 0], (turned @ (moment + np.cross(lever, force))[..., None])[..., 0]], axis=-1
    )


def test_the_weight_of_the_payload_is_gone_at_any_tilt():
    rotation = pose.rotation_from_rotvec(np.random.default_rng(0).uniform(-2, 2, (50, 3)))
    ft = sensor(50)
    ft.read(weight(rotation), rotation)
    assert np.linalg.norm(ft.raw[:, :3], axis=1) == pytest.approx(np.full(50, MASS * 9.81))
    assert ft.wrench == pytest.approx(np.zeros((50, 6)), abs=1e-12)


def test_a_wrench_at_the_tcp_is_reported_in_base_axes_at_any_tilt():
    rng = np.random.default_rng(1)
    rotation = pose.rotation_from_rotvec(rng.uniform(-2, 2, (50, 3)))
    force, moment = rng.uniform(-8, 8, (50, 3)), rng.uniform(-1, 1, (50, 3))
    ft = sensor(50)
    ft.read(weight(rotation) + contact(rotation, force, moment, rotation @ np.array([0, 0, TCP])), rotation)
    assert ft.wrench == pytest.approx(np.concatenate([force, moment], 1), abs=1e-12)


def test_an_upward_force_beside_the_tip_turns_about_the_tip_by_the_right_hand_rule():
    ft = sensor()
    force, beside = np.array([[0.0, 0.0, 10.0]]), np.array([[0.01, 0.0, 0.0]])
    ft.read(weight(DOWN) + contact(DOWN, force, 0 * force, DOWN @ np.array([0, 0, TCP]) + beside), DOWN)
    assert ft.wrench[0] == pytest.approx([0, 0, 10, 0, -0.1, 0], abs=1e-12)


@pytest.mark.parametrize("delay", [1, 2, 3, 4])
def test_a_load_shows_exactly_the_delay_later(delay):
    ft = sensor(sensor_delay=delay)
    load = np.zeros((1, 6))
    for _ in range(10):
        ft.read(load, DOWN)
    load[0, 0] = 5.0
    seen = []
    for _ in range(6):
        ft.read(load, DOWN)
        seen.append(ft.raw[0, 0])
    # what MuJoCo gives is one tick old itself
    assert seen == [0.0] * (delay - 1) + [5.0] * (7 - delay)


def test_sensors_of_one_world_have_delays_of_their_own():
    ft = ForceTorqueSensor(2, MASS, (0, 0, COM), (0, 0, TCP))
    ft.reset(0, episode(sensor_delay=1))
    ft.reset(1, episode(sensor_delay=4))
    ft.read(np.zeros((2, 6)), np.repeat(DOWN, 2, 0))
    ft.read(np.full((2, 6), 3.0), np.repeat(DOWN, 2, 0))
    assert ft.raw[:, 0].tolist() == [3.0, 0.0]


@pytest.mark.parametrize("channel", range(6))
def test_a_channel_at_the_end_of_its_range_is_saturated_and_says_so(channel):
    ft = sensor()
    load = np.zeros((1, 6))
    load[0, channel] = 0.99 * RANGE[channel]
    ft.read(load, DOWN)
    assert not ft.saturated[0]
    load[0, channel] = -3 * RANGE[channel]
    ft.read(load, DOWN)
    assert ft.saturated[0]
    assert ft.raw[0, channel] == -RANGE[channel]


def test_bias_drifts_and_zero_takes_it_away():
    bias, drift = np.array([2.0, -1.0, 3.0, 0.1, -0.1, 0.05]), np.array([0.5, 0, 0, 0, 0, 0])
    ft = sensor(bias=bias, drift=drift)
    ft.read(weight(DOWN), DOWN)
    assert ft.raw[0] - weight(DOWN)[0] == pytest.approx(bias)
    for _ in range(500):
        ft.read(weight(DOWN), DOWN)
    assert (ft.raw[0] - weight(DOWN)[0] - bias)[0] == pytest.approx(0.5 * 500 * TICK_S)
    ft.zero(np.array([0]))
    ft.read(weight(DOWN), DOWN)
    lag = 0.5 * TICK_S * ZERO_TICKS
    assert ft.wrench[0, 0] == pytest.approx(lag, abs=0.01)  # the average trails a drift by its time constant
    assert ft.wrench[0, 1:3] == pytest.approx([0.0, 0.0], abs=1e-3)


def test_a_zero_right_after_a_reset_is_as_good_as_one_after_a_long_rest():
    ft = sensor(bias=np.full(6, 0.5), mass_scale=1.2)
    ft.zero(np.array([0]))
    ft.read(weight(DOWN, 1.2 * MASS), DOWN)
    assert ft.wrench[0] == pytest.approx(np.zeros(6), abs=1e-9)


def test_any_payload_and_tcp_can_be_configured():
    rng = np.random.default_rng(2)
    rotation = pose.rotation_from_rotvec(rng.uniform(-2, 2, (50, 3)))
    centre, tip = rng.uniform(-0.2, 0.2, (2, 3))
    force, moment = rng.uniform(-5, 5, (50, 3)), rng.uniform(-1, 1, (50, 3))
    carried = rotation.swapaxes(-1, -2) @ np.array([0.0, 0.0, -1.7 * 9.81])
    carried = np.concatenate([carried, np.cross(centre, carried)], axis=1)
    ft = sensor(50)
    ft.configure(1.7, centre, tip, rotation)
    ft.read(carried + contact(rotation, force, moment, rotation @ tip), rotation)
    assert ft.wrench == pytest.approx(np.concatenate([force, moment], 1), abs=1e-12)


def test_a_zero_after_another_payload_is_as_good_as_one_before():
    ft = sensor(bias=np.full(6, 0.5))
    tilted = pose.rotation_from_rotvec(np.array([[2.5, 0.4, 0.0]]))
    for _ in range(2000):
        ft.read(weight(tilted), tilted)
    ft.configure(0.2, (0.1, 0.0, 0.0), (0.0, 0.0, TCP), tilted)
    ft.zero(np.array([0]))
    ft.read(weight(tilted), tilted)
    assert ft.wrench[0] == pytest.approx(np.zeros(6), abs=1e-6)


def test_zeroing_one_sensor_leaves_the_others():
    ft = sensor(2, bias=np.full(6, 1.0))
    ft.read(np.repeat(weight(DOWN), 2, 0), np.repeat(DOWN, 2, 0))
    ft.zero(np.array([1]))
    ft.read(np.repeat(weight(DOWN), 2, 0), np.repeat(DOWN, 2, 0))
    assert np.abs(ft.wrench[0, :3]) == pytest.approx(np.ones(3))
    assert np.abs(ft.wrench[1, :3]) == pytest.approx(np.zeros(3), abs=1e-9)


def test_the_noise_has_the_stated_deviation_is_white_and_reaches_the_wrench():
    noisy = draw(Task(3))
    ft = sensor(wrench_noise=noisy.wrench_noise)
    seen = np.zeros((4000, 6))
    for row in seen:
        ft.read(weight(DOWN), DOWN)
        row[:] = ft.raw[0] - weight(DOWN)[0]
    assert seen.std(0) == pytest.approx([0.7] * 3 + [0.05] * 3, rel=0.05)
    assert (seen[1:] * seen[:-1]).mean(0) / seen.var(0) == pytest.approx(np.zeros(6), abs=0.06)
    # a moment at the TCP hears the noise of the force over the lever too
    assert ft.wrench.shape == (1, 6)


def test_nothing_of_an_episode_is_left_after_a_reset():
    ft = sensor(bias=np.full(6, 5.0), sensor_delay=4)
    for _ in range(20):
        ft.read(np.full((1, 6), 40.0), DOWN)
    ft.zero(np.array([0]))
    ft.reset(0, episode(sensor_delay=4))
    assert not ft.wrench.any()
    assert not ft.saturated.any()
    for _ in range(6):
        ft.read(weight(DOWN), DOWN)
        assert ft.wrench[0] == pytest.approx(np.zeros(6), abs=1e-12)


def test_a_drift_ends_once_the_sensor_is_warm_and_is_a_ramp_until_then():
    ft = sensor(drift=np.array([0.02, 0, 0, 0, 0, 0]))
    for ticks, drifted in ((0, 0.0), (25_000, 1.0), (50_000, 2.0), (7 * 24 * 3600 * 500, 2.0)):
        ft._tick[0] = ticks
        ft.read(weight(DOWN), DOWN)
        assert ft.wrench[0, 0] == pytest.approx(drifted)


def test_the_unzeroed_reading_keeps_what_a_zero_takes_away():
    ft = sensor(bias=np.array([1.0, -2.0, 3.0, 0.1, 0.0, 0.0]))
    before = None
    for _ in range(20 * ZERO_TICKS):
        ft.read(weight(DOWN), DOWN)
    before = ft.unzeroed(DOWN)
    assert before == pytest.approx(ft.wrench)
    ft.zero(np.array([0]))
    ft.read(weight(DOWN), DOWN)
    assert ft.wrench == pytest.approx(np.zeros((1, 6)), abs=1e-6)
    assert ft.unzeroed(DOWN) == pytest.approx(before)
