from math import pi

import numpy as np
import pytest

from service.policy.action import ActionMap
from service.policy.contract import ActionEntry
from tests.service.policy.model_files import ACTION


def test_full_deflection_is_the_limit_and_half_of_it_a_quarter_where_squared() -> None:
    actions = ActionMap(ACTION)
    np.testing.assert_allclose(actions.displacement([1, -1, 1, -1], 0.0), [3e-3, -3e-3, 1.5e-3, -0.14])
    np.testing.assert_allclose(actions.displacement([0.5, -0.5, 0.5, -0.5], 0.0), [0.75e-3, -0.75e-3, 0.75e-3, -0.07])


def test_dx_and_dy_turn_with_the_tool_where_the_contract_says_so() -> None:
    np.testing.assert_allclose(ActionMap(ACTION).displacement([1, 0, 0, 0], pi / 2), [0, 3e-3, 0, 0], atol=1e-15)
    base = [entry.model_copy(update={"frame": "base"}) for entry in ACTION]
    np.testing.assert_allclose(ActionMap(base).displacement([1, 0, 0, 0], pi / 2), [3e-3, 0, 0, 0])


def test_an_output_beyond_one_is_cut() -> None:
    actions = ActionMap(ACTION)
    output = [100.0, 0, -3, 0.5]
    np.testing.assert_allclose(actions.displacement(output, 0.0), [3e-3, 0, -1.5e-3, 0.07])
    np.testing.assert_allclose(actions.unit(output), [1, 0, -1, 0.5])


def test_nan_stays_nan_for_the_bounds_to_refuse() -> None:
    assert np.isnan(ActionMap(ACTION).displacement([0, np.nan, 0, 0], 0.3)).any()


@pytest.mark.parametrize("order", [("dyaw", "dx", "dy"), ("dx", "dy", "dyaw")])
def test_entries_come_in_the_contracts_order_and_a_missing_one_is_zero(order: tuple[str, ...]) -> None:
    by_name: dict[str, ActionEntry] = {entry.name: entry for entry in ACTION}
    actions = ActionMap([by_name[name] for name in order])
    value = {"dx": 1.0, "dy": -1.0, "dyaw": 0.5}
    output = [value[name] for name in order]
    np.testing.assert_allclose(actions.displacement(output, 0.0), [3e-3, -3e-3, 0, 0.07])
    np.testing.assert_allclose(actions.unit(output), [1, -1, 0, 0.5])


def test_a_batch_maps_as_its_elements_do() -> None:
    rng = np.random.default_rng(0)
    output, yaw = rng.normal(size=(2, 3, 4)), rng.normal(size=(2, 3))
    batch = ActionMap(ACTION).displacement(output, yaw)
    for index in np.ndindex(2, 3):
        np.testing.assert_array_equal(batch[index], ActionMap(ACTION).displacement(output[index], yaw[index]))
