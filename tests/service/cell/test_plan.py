"""The shipped cell runs a policy under the conditions of its training."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from service.cell.plan import Plan, plan_insertion
from service.config import load
from service.policy.contract import PolicyContract
from service.policy.model import Policy
from service.policy.step import command_bounds
from service.safety.bounds import BoundsParameters
from sim_backend.world.scene import NOMINAL_HOLE_M
from sim_backend.world.world import START_POSITION_M, START_YAW_RAD
from training.environment.design import vftm_dsl
from training.environment.insertion import Insertions
from wire.impact import blow_n
from wire.law import ControlLimits
from wire.limits import FORCE_CEILING_N, WORKSPACE_M
from wire.records import TICK_S

OF_TRAINING = ControlLimits(WORKSPACE_M, FORCE_CEILING_N)
SHIPPED = load(Path(__file__).parents[3] / "config" / "cell.toml")
NAME, RECIPE = next(iter(SHIPPED.recipes.items()))


@pytest.fixture(scope="module", params=["shipped", "of the next training"])
def contract(request: pytest.FixtureRequest) -> PolicyContract:
    return Policy.load(RECIPE.policy).contract if request.param == "shipped" else vftm_dsl()


@pytest.fixture(scope="module")
def plan(contract: PolicyContract) -> Plan:
    return plan_insertion(SHIPPED, RECIPE, contract)


@pytest.fixture(scope="module")
def trained(contract: PolicyContract) -> Insertions:
    return Insertions(contract, 1)


def test_the_compliance_law_is_the_one_of_training(plan: Plan, trained: Insertions) -> None:
    stiffness, damping, inertia = trained._law
    assert (plan.law.stiffness == stiffness).all()
    assert (plan.law.damping == damping).all()
    assert (plan.law.inertia == inertia).all()
    assert plan.limits.max_speed == trained._limits.max_speed == OF_TRAINING.max_speed


@pytest.mark.parametrize("name", [field.name for field in fields(BoundsParameters) if field.name != "tilt_rad"])
def test_a_command_is_bounded_as_in_training(plan: Plan, trained: Insertions, name: str) -> None:
    # The tilt bounds no command: the cell stops for it, and a trained policy does not reach it
    assert getattr(plan.step.bounds, name) == pytest.approx(getattr(trained._policy_step.bounds, name), abs=0.0)


def test_the_bounds_of_training_are_those_of_the_arms_own_program(contract: PolicyContract) -> None:
    bounds = command_bounds(OF_TRAINING, contract.period_s, 0.0)
    assert (bounds.step_m, bounds.step_rad) == OF_TRAINING.max_step
    assert (bounds.speed_mps, bounds.speed_radps) == OF_TRAINING.max_speed


def test_the_arms_own_program_has_the_limits_of_training(plan: Plan, trained: Insertions) -> None:
    limits = trained._limits
    assert tuple(plan.limits.max_step) == limits.max_step
    assert (plan.limits.workspace == np.array(limits.workspace)).all()
    assert plan.limits.force_ceiling_n == limits.force_ceiling_n
    # Shorter in the cell: training has no clock that could be late. Longer than any step, or a held target would stop.
    assert plan.step.ticks * plan.tick_s + plan.policy_deadline_s < plan.limits.target_age_s <= limits.target_age_s


def test_lock_wrench_window_period_and_action_are_those_of_training(plan: Plan, trained: Insertions) -> None:
    assert plan.step.lock == trained._policy_step.lock
    assert plan.step.ticks == len(trained._window)
    assert plan.tick_s == TICK_S
    assert plan.max_steps == trained.contract.max_steps
    assert plan.step.observation_size == trained.observation_size
    assert plan.step.actions.size == trained.action_size


def test_start_and_nominal_hole_of_the_shipped_recipe_are_those_of_training(plan: Plan) -> None:
    assert tuple(plan.start_position) == START_POSITION_M
    assert plan.start_yaw == START_YAW_RAD
    assert tuple(plan.nominal_hole) == NOMINAL_HOLE_M


def test_the_cells_stiffest_law_admits_the_one_of_training(plan: Plan) -> None:
    assert (np.array(plan.law.stiffness) <= np.array(SHIPPED.limits.max_stiffness)).all()


@pytest.mark.parametrize(("force_ceiling_n", "speed"), [(30.0, 0.08), (20.0, 0.0654), (8.0, 0.0262)])
def test_an_approach_without_a_speed_is_as_fast_as_its_part_bears(force_ceiling_n: float, speed: float) -> None:
    recipe = RECIPE.model_copy(update={"force_ceiling_n": force_ceiling_n})
    planned = plan_insertion(SHIPPED, recipe, vftm_dsl()).approach_speed_m_s
    assert planned == pytest.approx(speed, abs=5e-4)
    assert blow_n(planned, 2.5, SHIPPED.limits.contact_n_m) <= 2.0 * force_ceiling_n + 1e-9


def test_an_approach_at_the_recipes_speed_is_at_the_recipes_speed() -> None:
    recipe = RECIPE.model_copy(update={"approach_speed_m_s": 0.033})
    assert plan_insertion(SHIPPED, recipe, vftm_dsl()).approach_speed_m_s == 0.033
