import dataclasses
import json

import numpy as np
import pytest

from sim_backend.world.conditions import NOISE_ROWS, draw
from sim_backend.world.scene import NOMINAL_HOLE_M
from training.environment import design
from training.environment.insertion import Insertions
from wire.task import Task

N = 2000


@pytest.fixture(scope="module")
def standard():
    return [draw(Task(seed, randomise_plant=True)) for seed in range(N)]


def column(episodes, name):
    return np.array([getattr(episode, name) for episode in episodes])


def assert_uniform(values, low, high):
    assert values.min() >= low
    assert values.max() <= high
    width = high - low
    assert values.min() < low + 0.01 * width
    assert values.max() > high - 0.01 * width
    assert values.mean() == pytest.approx((low + high) / 2, abs=4 * width / np.sqrt(12 * N))


def assert_normal(values, sigma):
    assert values.mean() == pytest.approx(0.0, abs=4 * sigma / np.sqrt(len(values)))
    assert values.std() == pytest.approx(sigma, rel=4 / np.sqrt(2 * len(values)))


def test_the_hole_lies_anywhere_in_its_box_and_is_turned_either_way(standard):
    hole = column(standard, "hole_position") - NOMINAL_HOLE_M
    for axis, half in enumerate((0.050, 0.035, 0.030)):
        assert_uniform(hole[:, axis], -half, half)
    assert_uniform(np.rad2deg(column(standard, "hole_yaw")), -60, 60)


def test_estimate_and_grasp_are_off_by_their_deviations(standard):
    offset = column(standard, "estimate_offset")
    for axis, sigma in enumerate((1.15e-3, 1.15e-3, 0.5e-3)):
        assert_normal(offset[:, axis], sigma)
    assert_normal(column(standard, "grasp_offset").ravel(), 0.3e-3)
    assert_normal(column(standard[:200], "estimate_noise").ravel(), 0.17e-3)


def test_the_approach_ends_20_to_30_mm_above_the_estimate(standard):
    assert_uniform(column(standard, "hover_m"), 0.020, 0.030)


def test_the_sensor_is_noisy_biased_drifting_and_late(standard):
    noise = np.stack([episode.wrench_noise for episode in standard[:20]])
    assert noise.shape == (20, NOISE_ROWS, 6)
    assert_normal(noise[..., :3].ravel(), 0.7)
    assert_normal(noise[..., 3:].ravel(), 0.05)
    assert_normal(column(standard, "bias")[:, :3].ravel(), 2.0)
    assert_normal(column(standard, "bias")[:, 3:].ravel(), 0.1)
    assert_normal(column(standard, "drift")[:, :3].ravel(), 0.02)
    delay = column(standard, "sensor_delay")
    assert set(delay) == {1, 2, 3, 4}
    assert np.bincount(delay)[1:] == pytest.approx([N / 4] * 4, rel=0.2)


@pytest.mark.parametrize("ticks", [1, 2, 3, 4])
def test_a_task_may_name_the_delay_of_its_sensor_and_nothing_else_changes(ticks):
    drawn, named = draw(Task(5)), draw(Task(5, sensor_delay_ticks=ticks))
    assert named.sensor_delay == ticks
    for field in dataclasses.fields(drawn):
        if field.name != "sensor_delay":
            assert np.array_equal(getattr(drawn, field.name), getattr(named, field.name))


@pytest.mark.parametrize("ticks", [0, 5, -1, 2.0, True, "2"])
def test_a_delay_that_the_sensor_does_not_have_is_refused(ticks):
    with pytest.raises(ValueError, match=r"task\.sensor_delay_ticks must be null or an integer from 1 to 4, not"):
        Task.from_json({"seed": 0, "sensor_delay_ticks": ticks})


def test_a_task_survives_json_with_and_without_a_delay():
    for task in (Task(3), Task(3, sensor_delay_ticks=2)):
        assert Task.from_json(json.loads(json.dumps(task.to_json()))) == task


def test_a_seed_means_the_world_that_the_shipped_policy_was_trained_in():
    episode = draw(Task(12345))
    assert episode.hole_position == pytest.approx([0.2727336, -0.12282692, 0.09784193], abs=1e-8)
    assert episode.sensor_delay == 3
    assert episode.hover_m == pytest.approx(0.029418028652699373)
    assert episode.estimate_noise[-1, 2] == pytest.approx(0.0001026789169159376)  # the last draw of all


def test_a_randomised_plant_varies_as_the_standard_conditions_say(standard):
    assert_uniform(column(standard, "friction"), 0.1, 0.6)
    assert_uniform(column(standard, "stiffness_scale"), 0.6, 1.4)
    assert_uniform(column(standard, "mass_scale"), 0.8, 1.2)
    assert_uniform(column(standard, "contact_time_s"), 6e-3, 14e-3)
    assert set(column(standard, "target_delay")) == set(range(11))


def test_a_plant_that_is_not_randomised_is_nominal_and_changes_nothing_else(standard):
    varied = {"friction": 0.3, "stiffness_scale": 1.0, "mass_scale": 1.0, "contact_time_s": 12e-3, "target_delay": 2}
    for seed in range(20):
        plain = draw(Task(seed))
        for field in dataclasses.fields(plain):
            value = getattr(plain, field.name)
            if field.name in varied:
                assert value == varied[field.name]
            else:
                assert np.array_equal(value, getattr(standard[seed], field.name))


def test_easy_conditions_are_narrower():
    easy = [draw(Task(seed, conditions="easy")) for seed in range(300)]
    hole = np.abs(column(easy, "hole_position") - NOMINAL_HOLE_M).max(0)
    assert (hole <= [0.020, 0.020, 0.010]).all()
    assert (hole > [0.019, 0.019, 0.0095]).all()
    assert np.rad2deg(np.abs(column(easy, "hole_yaw")).max()) == pytest.approx(30, abs=1)
    assert_normal(column(easy, "estimate_offset")[:, :2].ravel(), 0.5e-3)
    assert_normal(column(easy, "grasp_offset").ravel(), 0.1e-3)


def test_a_search_begins_within_10_mm_of_the_hole_and_is_standard_otherwise():
    search, standard = ([draw(Task(seed, conditions=name)) for seed in range(300)] for name in ("search", "standard"))
    hole = np.abs(column(search, "hole_position") - NOMINAL_HOLE_M).max(0)
    assert (hole <= 0.010).all()
    assert (hole > 0.0098).all()
    for one, other in zip(search, standard, strict=True):
        for field in dataclasses.fields(one):
            if field.name != "hole_position":
                assert np.array_equal(getattr(one, field.name), getattr(other, field.name))


def test_stiff_conditions_are_the_standard_ones_but_for_the_contact():
    for seed in range(20):
        there, here = draw(Task(seed, conditions="stiff")), draw(Task(seed))
        assert (there.contact_time_s, here.contact_time_s) == (6e-3, 12e-3)
        for field in dataclasses.fields(here):
            if field.name != "contact_time_s":
                assert np.array_equal(getattr(there, field.name), getattr(here, field.name))


def test_where_the_contact_is_stiffer_a_peg_sinks_less():
    """The lock alone sets the pegs down beside their holes and presses with 9 N."""
    contract = design.adjusted(design.contract_for(), press_m=3e-3)
    cells = Insertions(contract, 2)
    cells.reset(np.arange(2), [Task(1, conditions="standard"), Task(1, conditions="stiff")])
    for _ in range(40):
        outcome = cells.step(np.zeros((2, 4)))
    soft, hard = outcome.depth
    assert 0 < 2 * hard < soft < 0.3e-3


def test_a_transfer_has_the_standard_poses_on_another_plant():
    other_plant = {"friction": 0.7, "stiffness_scale": 1.5, "sensor_delay": 5}
    for seed in range(20):
        there, here = draw(Task(seed, conditions="transfer")), draw(Task(seed))
        for field in dataclasses.fields(here):
            value, standard = getattr(there, field.name), getattr(here, field.name)
            if field.name in other_plant:
                assert value == other_plant[field.name]
            elif field.name == "bias":
                assert value == pytest.approx(2 * standard)
            elif field.name == "wrench_noise":
                assert value[:, :3] == pytest.approx(standard[:, :3] / 0.7, rel=1e-5)
                assert value[:, 3:] == pytest.approx(standard[:, 3:] * 1.4, rel=1e-5)
            else:
                assert np.array_equal(value, standard)


def test_a_transfers_plant_is_given_and_only_its_sensors_delay_may_be_named():
    assert draw(Task(5, conditions="transfer", sensor_delay_ticks=2)).sensor_delay == 2
    for given in ("stiff", "transfer"):
        with pytest.raises(ValueError, match=rf"task\.randomise_plant must be false under conditions '{given}'"):
            Task.from_json({"seed": 0, "conditions": given, "randomise_plant": True})


def test_the_same_seed_is_the_same_episode_whatever_the_part_and_the_clearance():
    one, other = draw(Task(7)), draw(Task(7, part="cir", clearance_m=1e-3))
    for field in dataclasses.fields(one):
        assert np.array_equal(getattr(one, field.name), getattr(other, field.name))
    assert not np.array_equal(one.hole_position, draw(Task(8)).hole_position)
