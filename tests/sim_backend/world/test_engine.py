"""The callbacks of the compiled tick in a process that has other models and other callbacks too."""

import ctypes
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import mujoco
import numpy as np
import pytest

from sim_backend.world import compiled, engine
from sim_backend.world.world import World
from tests.sim_backend.world.compiled.twins import assert_equal, needs_the_extension, of_world
from wire.law import ControlLimits
from wire.limits import WORKSPACE_M
from wire.task import Task

pytestmark = needs_the_extension

LAW = (
    np.array([2500.0, 2500.0, 3000.0, 5.0, 5.0, 8.0]),
    np.array([320.0] * 3 + [1.0] * 3),
    np.array([2.5] * 3 + [0.06] * 3),
)
TICKS = 30


@pytest.fixture(autouse=True)
def _callbacks() -> Iterator[None]:
    yield
    mujoco.set_mjcb_control(None)
    mujoco.set_mjcb_time(None)


def reaching(n: int, threads: int = 1) -> World:
    """A world whose arms go down beside their holes."""
    world = World(n, threads=threads)
    cells = np.arange(n)
    world.reset(cells, [Task(seed, randomise_plant=True) for seed in range(n)])
    world.place(cells, world.hole_position + np.array([0.004, 0.0, 1e-3]), world.hole_yaw)
    world.zero_ft(cells)
    world.engage(cells, *LAW, ControlLimits(WORKSPACE_M, 30.0))
    world.arm.set_target(cells, world.arm.target_position - [0.0, 0.0, 4e-3], world.arm.target_quaternion)
    return world


def advance(world: World) -> np.ndarray:
    readings = np.zeros((TICKS, world.n, 6))
    world.advance(readings)
    return readings


def calls(world: World, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return the numbers of steps in the calls of MuJoCo that the world makes from now on."""
    seen: list[int] = []
    step: Callable[..., None] = world._batch.step

    def noted(nstep: int = 1) -> None:
        seen.append(nstep)
        step(nstep=nstep)

    monkeypatch.setattr(world._batch, "step", noted)
    return seen


def test_ticks_are_one_call_and_leave_no_trace_in_the_state(monkeypatch: pytest.MonkeyPatch) -> None:
    world = reaching(3)
    made = calls(world, monkeypatch)
    assert np.abs(advance(world)[-1]).max() > 1.0
    assert made == [TICKS]
    assert not world._batch.expand("numeric_data").any()


def test_a_single_tick_may_follow_a_call_and_precede_one() -> None:
    one, other = reaching(3), reaching(3)
    other._together = None
    for world in (one, other):
        for _ in range(3):
            advance(world)
            world.tick()
    assert_equal(of_world(one), of_world(other), "the end")


def test_with_the_control_callback_of_another_the_ticks_are_single_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = advance(reaching(3))
    world = reaching(3)
    foreign = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(compiled.tick.CONTROL)  # another object
    mujoco.set_mjcb_control(foreign)
    made = calls(world, monkeypatch)
    np.testing.assert_array_equal(advance(world), expected)
    assert made == [1] * TICKS
    assert mujoco.get_mjcb_control() is foreign
    assert "another control callback" in engine.describe()


def test_a_callback_that_is_replaced_within_the_call_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    world = reaching(2)
    step = world._batch.step

    def replaced(nstep: int) -> None:
        mujoco.set_mjcb_control(None)
        step(nstep=nstep)

    monkeypatch.setattr(world._batch, "step", replaced)
    with pytest.raises(RuntimeError, match="another control callback"):
        advance(world)
    assert not world._batch.expand("numeric_data").any()


@pytest.mark.parametrize(("name", "value", "reason"), [("MUJOCO", 1, "built for MuJoCo 1"), ("INVERTS", 0, "inverse")])
def test_an_extension_that_does_not_fit_makes_single_calls(
    name: str, value: int, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiled.tick, name, value)
    assert reason in engine.obstacle()
    world = reaching(1)
    made = calls(world, monkeypatch)
    advance(world)
    assert made == [1] * TICKS


def test_an_error_in_the_call_reaches_the_caller_and_closes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    world = reaching(2)

    def failing(nstep: int) -> None:
        raise mujoco.batch.SimulationError(np.array([1]), "the simulation failed")

    monkeypatch.setattr(world._batch, "step", failing)
    with pytest.raises(mujoco.batch.SimulationError):
        advance(world)
    assert not world._batch.expand("numeric_data").any()


def test_a_step_too_many_is_an_error_and_writes_beyond_no_array(monkeypatch: pytest.MonkeyPatch) -> None:
    world = reaching(2)
    step = world._batch.step
    monkeypatch.setattr(world._batch, "step", lambda nstep: step(nstep=nstep + 3))
    readings = np.full((TICKS + 4, 2, 6), np.pi)
    with pytest.raises(RuntimeError, match="callback"):
        world.advance(readings[:TICKS])
    assert (readings[TICKS:] == np.pi).all()


@pytest.mark.parametrize("number", [-1.0, 1e9, np.nan])
@pytest.mark.parametrize("place", [0, 1])
def test_a_scene_without_the_tool_is_an_error(place: int, number: float) -> None:
    world = reaching(2)
    assert world._together is not None
    world._together._constants[place] = number
    with pytest.raises(RuntimeError, match="callback"):
        advance(world)


def test_readings_that_do_not_fit_are_refused_and_leave_the_world_as_it_is() -> None:
    world, same = reaching(2), reaching(2)
    for bad in (np.zeros((TICKS, 2, 6), np.float32), np.zeros((TICKS, 3, 6)), np.zeros((TICKS, 6, 2)).swapaxes(1, 2)):
        with pytest.raises(TypeError, match="readings"):
            world.advance(bad)
    np.testing.assert_array_equal(advance(world), advance(same))
    assert_equal(of_world(world), of_world(same), "the end")


def test_no_ticks_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    world = reaching(2)
    made, before = calls(world, monkeypatch), {name: array.copy() for name, array in of_world(world).items()}
    world.advance(np.zeros((0, 2, 6)))
    assert_equal(of_world(world), before, "the end")
    assert made == []


@pytest.mark.parametrize("ticks", [0, 5])
@pytest.mark.parametrize(
    ("bad", "kind"),
    [
        ({"_qpos": np.nan}, mujoco.mjtWarning.mjWARN_BADQPOS),
        ({"_qpos": -1e11}, mujoco.mjtWarning.mjWARN_BADQPOS),
        ({"_qvel": np.inf}, mujoco.mjtWarning.mjWARN_BADQVEL),
        ({"_qvel": 1e5}, mujoco.mjtWarning.mjWARN_BADQACC),
    ],
)
def test_a_simulation_that_mujoco_resets_goes_on_as_tick_by_tick(
    bad: dict[str, float], kind: mujoco.mjtWarning, ticks: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes of it to a file
    one, other = reaching(3), reaching(3)
    other._together = None
    for world in (one, other):
        world.advance(np.zeros((ticks, 3, 6)))
        for name, number in bad.items():
            getattr(world, name)[1, 2] = number
        with np.errstate(all="ignore"):
            advance(world)
            world.tick()
            advance(world)
    assert_equal(of_world(one), of_world(other), "the end")
    assert one._batch.warning[1, kind.value].any()
    assert not one._batch.warning[[0, 2]].any()


def test_a_second_thread_that_advances_the_same_cells_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    world, expected = reaching(2), advance(reaching(2))
    step = world._batch.step

    def disturbed(nstep: int) -> None:
        with ThreadPoolExecutor(1) as pool, pytest.raises(RuntimeError, match="another thread advances"):
            pool.submit(advance, world).result()
        step(nstep=nstep)

    monkeypatch.setattr(world._batch, "step", disturbed)
    np.testing.assert_array_equal(advance(world), expected)
    monkeypatch.undo()
    advance(world)


def copied_within_a_call(monkeypatch: pytest.MonkeyPatch) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return model and data of a world that is gone."""
    world, copies = reaching(1), list[tuple[mujoco.MjModel, mujoco.MjData]]()
    step = world._batch.step

    def copied(nstep: int) -> None:
        copies.append((world.model(), world.data()))
        step(nstep=nstep)

    with monkeypatch.context() as patch:
        patch.setattr(world._batch, "step", copied)
        advance(world)
    return copies[0]


def test_a_model_that_is_copied_within_a_call_outlives_the_world(monkeypatch: pytest.MonkeyPatch) -> None:
    model, data = copied_within_a_call(monkeypatch)
    assert not model.numeric_data.any()
    data.ctrl[:] = 0.5
    mujoco.mj_step(model, data, 3)
    assert (data.ctrl == 0.5).all()


def test_other_models_with_numbers_of_their_own_are_left_alone() -> None:
    advance(reaching(1))
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><custom><numeric name="n" data="0 3"/></custom><worldbody><body><joint name="j" type="slide"/>
        <geom size="1" mass="1"/></body></worldbody><actuator><motor joint="j"/></actuator></mujoco>"""
    )
    model.numeric_data[0] = 1e-310  # as good as an address
    data = mujoco.MjData(model)
    data.ctrl[0] = 0.5
    mujoco.mj_step(model, data, 3)
    assert data.ctrl[0] == 0.5


def test_worlds_advance_on_threads_at_the_same_time() -> None:
    expected = [advance(reaching(n)) for n in (1, 2, 5, 9)]
    worlds = [reaching(n, threads=2) for n in (1, 2, 5, 9)]
    with ThreadPoolExecutor(4) as pool:
        for found, wanted in zip(pool.map(advance, worlds), expected, strict=True):
            np.testing.assert_array_equal(found, wanted)


def test_timers_of_mujoco_stand_still_and_a_clock_of_another_stays() -> None:
    world = World(1)
    data = world.data()
    mujoco.mj_step(world.model(), data)
    assert data.timer[mujoco.mjtTimer.mjTIMER_STEP].number == 1
    assert data.timer[mujoco.mjtTimer.mjTIMER_STEP].duration == 0.0
    own = ctypes.CFUNCTYPE(ctypes.c_double)(compiled.tick.CLOCK)
    mujoco.set_mjcb_time(own)
    World(1)
    assert mujoco.get_mjcb_time() is own
