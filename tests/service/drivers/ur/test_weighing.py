"""The payload is weighed at an emulated arm that another client moves from attitude to attitude."""

import re
from contextlib import aclosing

import numpy as np
import pytest

from service.commands.weighing import weigh
from service.drivers.base import DriverError
from service.drivers.ur import gate
from service.drivers.ur.script_upload import upload
from service.drivers.ur.weighing import SETTLE_S, WINDOW_S, RestReader, scale_of, weighings
from service.faults import FaultCode
from service.safety.weighing import Weighing
from service.testing.lying_sensor import LIES, LyingSensor
from sim_backend.world import scene
from tests.service.drivers.ur.attitudes import movej, targets
from tests.service.drivers.ur.cells import ur_config
from tests.service.drivers.ur.emulated import Emulated, emulated
from tests.service.drivers.ur.test_samples import package
from wire.records import TICK_S
from wire.rtde.modes import RuntimeState

FROZEN = [name for name in LIES if name.endswith("frozen")]
SEEN_AT_SEVERAL = {
    "sign of Fx": "Fx with the wrong sign",
    "sign of Fy": "Fy with the wrong sign",
    "sign of Fz": "Fz with the wrong sign",
    "sign of forces": "Fx, Fy, Fz with the wrong sign",
    "sign of all": "Fx, Fy, Fz with the wrong sign",
    "gain 0.2": "gain 0.20 on all axes",
    "gain 0.5": "gain 0.50 on all axes",
    "gain 0.67": "gain 0.67 on all axes",
    "gain 2": "at the end of the sensor's range",
    "gain 5": "at the end of the sensor's range",
    "x and y swapped": "x and y are swapped",
    "x and z swapped": "x and z are swapped",
}


async def jog(arm: Emulated, attitude: int) -> None:
    ur = arm.config.ur
    assert ur is not None
    await upload(ur.host, ur.primary_port, movej(targets()[attitude]))


async def weighed(arm: Emulated, lie: str | None = None, attitudes: int = 4) -> Weighing:
    """Weigh from the start pose on, and move the arm as soon as an attitude is taken."""
    assert arm.config.ur is not None
    if lie is not None:
        LyingSensor(arm.plant.world).begin(LIES[lie], absolute=True)
    async with aclosing(weighings(arm.config.ur, lambda turned_rad: None)) as stream:
        weighing = await anext(stream)
        for attitude in range(1, attitudes):
            await jog(arm, attitude)
            weighing = await anext(stream)
    return weighing


async def test_an_honest_sensor_and_the_right_payload_pass() -> None:
    async with emulated() as arm:
        weighing = await weighed(arm)
        assert weighing.findings == ()
        assert weighing.passed
        assert weighing.mass_kg == pytest.approx(scene.PAYLOAD_KG, abs=0.02)
        assert weighing.joints_kg == pytest.approx(scene.PAYLOAD_KG, abs=0.15)
        assert weighing.centre_m == pytest.approx([0.0, 0.0, scene.PAYLOAD_COM_M], abs=3e-3)


@pytest.mark.parametrize("lie", SEEN_AT_SEVERAL)
async def test_07_66_67_a_sensor_that_lies_from_the_start_about_any_axis_is_found(lie: str) -> None:
    async with emulated() as arm:
        weighing = await weighed(arm, lie)
        assert not weighing.passed
        assert SEEN_AT_SEVERAL[lie] in weighing.findings[0]


@pytest.mark.parametrize("lie", FROZEN)
async def test_64_65_a_frozen_channel_is_found_at_the_first_attitude(lie: str) -> None:
    async with emulated() as arm:
        (finding,) = (await weighed(arm, lie, 1)).findings
        frozen = {"forces frozen": "Fx, Fy, Fz frozen", "torques frozen": "Tx, Ty, Tz frozen"}
        assert finding.startswith(frozen.get(lie, lie))


def test_these_tests_have_every_lie() -> None:
    assert {*FROZEN, *SEEN_AT_SEVERAL} == set(LIES)


async def test_an_operator_is_told_what_was_taken_what_comes_next_and_what_was_too_near() -> None:
    told: list[str] = []
    async with emulated() as arm:
        assert arm.config.ur is not None
        steps = iter([1, 1, 2, 0, 3])

        def tell(line: str) -> None:
            told.append(line)

        moved = 0

        def move_on() -> None:
            """Run a program of another client whenever the command asks for another attitude."""
            nonlocal moved
            asked = sum(line.startswith(("next", "only")) for line in told)
            if asked > moved and arm.controller.runtime_state == RuntimeState.STOPPED:
                moved = asked
                target = targets()[next(steps)]
                target[5] += 0.1 * (asked == 2)
                arm.controller.run_script(movej(target))

        arm.before_tick = move_on
        weighing = await weigh(arm.config.ur, tell)
    assert weighing.passed
    kinds = [line.split()[0] for line in told]
    assert kinds == ["Jog", "attitude", "next:", "attitude", "next:", "only", "attitude", "next:", "only", "attitude"]
    assert "raw force" in told[1]
    assert re.search("turn the tool until the flange's [xy] axis points (up|down)", told[2])
    assert told[5].startswith("only 6° from an attitude that was taken, 20° needed")
    assert told[8].startswith("only 0° from")


async def test_the_gate_compares_at_the_attitude_at_which_the_arm_stands() -> None:
    """It sees a lie about Fx before the control program is sent, if the flange's x axis has a share of the weight."""
    async with emulated() as arm:
        await weighed(arm, "sign of Fx", 2)
        await arm.driver.connect(arm)
        (failed,) = gate.failures(arm.driver.checks)
        assert failed.name == "F/T load"
        assert arm.controller.runtime_state == RuntimeState.STOPPED


async def test_it_reads_and_does_nothing_else_beside_a_driver_that_holds_the_registers() -> None:
    async with emulated() as arm:
        assert arm.config.ur is not None
        await arm.driver.connect(arm)
        await arm.until(lambda: len(arm.samples) > 0)
        zero, at = arm.plant.world.sensor._zero.copy(), arm.plant.q.copy()
        program = arm.samples[-1].program
        async with aclosing(weighings(arm.config.ur, lambda turned_rad: None)) as stream:
            await anext(stream)
        await arm.pass_time(0.2)
        assert arm.faults == []
        assert arm.samples[-1].program is program
        assert np.array_equal(arm.plant.world.sensor._zero, zero)
        assert arm.plant.q == pytest.approx(at, abs=1e-4)


async def test_no_program_runs_and_no_register_is_written_on_an_arm_of_nobody() -> None:
    async with emulated() as arm:
        states: set[RuntimeState] = set()
        arm.before_tick = lambda: states.add(arm.controller.runtime_state)
        assert arm.config.ur is not None
        async with aclosing(weighings(arm.config.ur, lambda turned_rad: None)) as stream:
            await anext(stream)
        assert states == {RuntimeState.STOPPED}
        assert not any(arm.controller.inputs.registers.ints)
        assert arm.controller.inputs.watchdogs == {}


async def test_an_operator_in_local_control_is_served() -> None:
    async with emulated(prepare=lambda controller: setattr(controller, "remote_control", False)) as arm:
        assert arm.config.ur is not None
        async with aclosing(weighings(arm.config.ur, lambda turned_rad: None)) as stream:
            assert len((await anext(stream)).rests) == 1


@pytest.mark.parametrize(
    ("ur", "switch_off", "text"),
    [
        ({"serial": "1"}, False, "another robot answers"),
        ({}, True, "ur power-on"),
    ],
)
async def test_another_robot_or_an_arm_without_power_is_refused(ur: dict, switch_off: bool, text: str) -> None:
    def prepare(controller) -> None:
        if switch_off:
            controller.power_off()

    async with emulated(ur_config(ur=ur), prepare=prepare) as arm:
        assert arm.config.ur is not None
        await arm.pass_time(0.5)
        with pytest.raises(DriverError, match=text):
            await weigh(arm.config.ur, lambda line: None)


async def test_a_controller_that_is_not_there_or_is_lost_ends_the_weighing() -> None:
    async with emulated(proxied=True) as arm:
        assert arm.config.ur is not None
        assert arm.proxy is not None
        async with aclosing(weighings(arm.config.ur, lambda turned_rad: None)) as stream:
            await anext(stream)
            await arm.proxy.reset()
            with pytest.raises(DriverError) as lost:
                await anext(stream)
        assert lost.value.code is FaultCode.LINK
        gone = arm.config.ur
    with pytest.raises(DriverError, match="is the controller on"):
        await weigh(gone, lambda line: None)


def test_a_rest_is_taken_once_it_has_settled_and_only_once_per_rest() -> None:
    reader = RestReader(scale_of(ur_config().ur))
    taken: list[int] = []
    ticks = round((SETTLE_S + WINDOW_S) / TICK_S)
    moves = {400, 2 * ticks + 100}
    for tick in range(4 * ticks):
        qd = (0.0, 0.0, 0.0, 0.03 * (tick in moves), 0.0, 0.0)
        off = 5 if tick == 3 * ticks + 150 else 7
        value = 9.0 if tick < 600 else 1.0
        now = package(time_s=60.0 + tick * TICK_S, qd=qd, robot_mode=off, ft_raw=(value, *[0.0] * 5))
        if (rest := reader.feed(now)) is not None:
            taken.append(tick)
            assert rest.wrench[0] == pytest.approx(1.0), "what was read while it settled does not count"
            assert rest.samples == round(WINDOW_S / TICK_S) + 1
            assert rest.down == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)
            assert rest.joints_kg == pytest.approx(0.93 - 3.0 / 9.81)
    assert taken == [401 + ticks, 2 * ticks + 101 + ticks]
