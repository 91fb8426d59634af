import asyncio
import random
from collections.abc import AsyncIterator, Awaitable, Callable

import pytest

from service.drivers.ur.dashboard import DashboardClient, DashboardError, DashboardErrorReason
from sim_backend.ur_controller.controller import Controller
from tests.fault_proxy import FaultProxy, chunked
from tests.service.drivers.ur.stepped import HOST, stepped_controller
from wire.rtde.modes import RobotMode, RuntimeState, SafetyMode

WAIT = "def wait():\n  while True:\n    sync()\n  end\nend\n"
Robot = tuple[Controller, DashboardClient]


@pytest.fixture
async def robot() -> AsyncIterator[Robot]:
    async with stepped_controller() as (controller, ports), DashboardClient(HOST, ports.dashboard) as dashboard:
        yield controller, dashboard


async def test_the_arm_is_powered_down_and_brought_up_again(robot: Robot) -> None:
    controller, dashboard = robot
    await dashboard.power_off()
    assert controller.robot_mode is RobotMode.POWER_OFF

    await dashboard.power_on()
    assert await dashboard.wait_for_robot_mode("IDLE", "RUNNING") == "IDLE"
    await dashboard.brake_release()
    assert await dashboard.wait_for_robot_mode("RUNNING") == "RUNNING"
    assert controller.robot_mode is RobotMode.RUNNING


async def test_a_mode_that_is_not_reached_is_named(robot: Robot) -> None:
    _, dashboard = robot

    with pytest.raises(DashboardError, match="stayed in RUNNING for 0 s instead of reaching IDLE") as raised:
        await dashboard.wait_for_robot_mode("IDLE", timeout_s=0.0)

    assert raised.value.reason is DashboardErrorReason.TIMEOUT
    assert await dashboard.robot_mode() == "RUNNING"


async def test_a_protective_stop_is_unlocked_once_it_is_5_s_old(robot: Robot) -> None:
    controller, dashboard = robot
    controller.protective_stop("test")
    assert await dashboard.safety_status() == "PROTECTIVE_STOP"
    with pytest.raises(DashboardError, match="5 s after it occurred") as raised:
        await dashboard.unlock_protective_stop()
    assert raised.value.reason is DashboardErrorReason.TOO_EARLY
    assert controller.safety_mode is SafetyMode.PROTECTIVE_STOP

    until_s = controller.time_s + 5.0
    while controller.time_s < until_s:
        await asyncio.sleep(0)
    await dashboard.unlock_protective_stop()
    await dashboard.close_safety_popup()
    assert await dashboard.safety_status() == "NORMAL"


async def test_a_fault_is_left_by_restarting_the_safety_system(robot: Robot) -> None:
    controller, dashboard = robot
    controller.fault("test")

    await dashboard.restart_safety()
    await dashboard.wait_for_robot_mode("POWER_OFF")
    assert await dashboard.safety_status() == "NORMAL"


async def test_a_program_is_loaded_played_paused_and_stopped(robot: Robot) -> None:
    controller, dashboard = robot
    controller.programs["wait.urp"] = WAIT

    await dashboard.load("wait.urp")
    assert await dashboard.program_state() == ("STOPPED", "wait.urp")
    await dashboard.play()
    assert await dashboard.is_running()
    await dashboard.pause()
    await dashboard.play()
    await dashboard.stop()
    assert controller.runtime_state in (RuntimeState.STOPPING, RuntimeState.STOPPED)


@pytest.mark.parametrize(
    ("order", "reply"),
    [
        (DashboardClient.stop, "Failed to execute: stop"),
        (DashboardClient.play, "Failed to execute: play"),
        (lambda client: client.load("none.urp"), "File not found: none.urp"),
    ],
)
async def test_a_refusal_has_the_controller_s_words(
    robot: Robot, order: Callable[[DashboardClient], Awaitable[None]], reply: str
) -> None:
    with pytest.raises(DashboardError, match=reply) as raised:
        await order(robot[1])

    assert (raised.value.reason, raised.value.reply) == (DashboardErrorReason.REFUSED, reply)
    assert await robot[1].robot_mode() == "RUNNING"


async def test_local_control_is_told_and_needs_another_connection(robot: Robot) -> None:
    controller, dashboard = robot
    controller.remote_control = False
    assert not await dashboard.is_in_remote_control()
    with pytest.raises(DashboardError, match="switch it on the pendant, then connect again") as raised:
        await dashboard.power_off()
    assert raised.value.reason is DashboardErrorReason.NOT_REMOTE
    assert controller.robot_mode is RobotMode.RUNNING

    controller.remote_control = True
    await dashboard.connect()
    assert await dashboard.is_in_remote_control()
    await dashboard.power_off()
    assert controller.robot_mode is RobotMode.POWER_OFF


async def test_it_asks_who_the_controller_is(robot: Robot) -> None:
    controller, dashboard = robot

    assert await dashboard.polyscope_version() == controller.versions[:3]
    assert await dashboard.serial_number() == controller.serial
    assert await dashboard.robot_model() == "UR3"


async def test_messages_are_shown_and_logged(robot: Robot) -> None:
    _, dashboard = robot

    await dashboard.popup("ready?")
    await dashboard.close_popup()
    await dashboard.add_to_log("batch 7")
    with pytest.raises(DashboardError, match="No log message"):
        await dashboard.add_to_log("")


async def test_commands_asked_at_once_keep_their_answers(robot: Robot) -> None:
    _, dashboard = robot

    answers = await asyncio.gather(*(dashboard.ask(line) for line in ("robotmode", "running", "safetystatus") * 10))

    assert answers == ["Robotmode: RUNNING", "Program running: false", "Safetystatus: NORMAL"] * 10


async def test_a_command_is_one_line(robot: Robot) -> None:
    with pytest.raises(ValueError, match="one line"):
        await robot[1].popup("first\npower off")


async def test_an_abandoned_question_does_not_leave_its_answer_to_the_next(robot: Robot) -> None:
    _, dashboard = robot
    asked = asyncio.ensure_future(dashboard.ask("running"))
    await asyncio.sleep(0)
    asked.cancel()
    with pytest.raises(asyncio.CancelledError):
        await asked

    assert not dashboard.is_connected
    with pytest.raises(DashboardError, match="connect first"):
        await dashboard.robot_mode()
    await dashboard.connect()
    assert await dashboard.robot_mode() == "RUNNING"


async def test_no_server_is_named() -> None:
    with pytest.raises(DashboardError, match=r"cannot reach the dashboard server at 127\.0\.0\.25:9") as raised:
        await DashboardClient(HOST, 9).connect()

    assert raised.value.reason is DashboardErrorReason.UNREACHABLE


@pytest.mark.parametrize(
    ("spoken", "reason"),
    [
        (b"SSH-2.0-OpenSSH\n", DashboardErrorReason.UNREACHABLE),
        (b"", DashboardErrorReason.LOST),
        (b"half a gree", DashboardErrorReason.LOST),
        (b"x" * 100_000, DashboardErrorReason.LOST),
    ],
)
async def test_what_is_no_dashboard_server_is_not_connected_to(spoken: bytes, reason: DashboardErrorReason) -> None:
    async def speak(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(spoken)
        writer.close()

    async with await asyncio.start_server(speak, HOST, 0) as server:
        client = DashboardClient(HOST, server.sockets[0].getsockname()[1])
        with pytest.raises(DashboardError) as raised:
            await client.connect()

    assert raised.value.reason is reason
    assert not client.is_connected


async def test_a_silent_server_ends_the_connection() -> None:
    async def greet(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"Connected: Universal Robots Dashboard Server\n")
        await reader.read()
        writer.close()

    async with await asyncio.start_server(greet, HOST, 0) as server:
        client = DashboardClient(HOST, server.sockets[0].getsockname()[1], reply_timeout_s=0.05)
        await client.connect()
        with pytest.raises(DashboardError, match="not answered within") as raised:
            await client.robot_mode()

    assert raised.value.reason is DashboardErrorReason.TIMEOUT
    assert not client.is_connected


async def test_answers_that_come_byte_by_byte_are_read_whole() -> None:
    async with stepped_controller() as (controller, ports), FaultProxy((HOST, ports.dashboard), HOST) as proxy:
        proxy.to_client.spoil = proxy.to_service.spoil = chunked(random.Random(0), 2)
        async with DashboardClient(proxy.host, proxy.port) as dashboard:
            assert await dashboard.polyscope_version() == controller.versions[:3]
            await dashboard.power_off()
            assert await dashboard.robot_mode() == "POWER_OFF"


async def test_a_connection_that_is_reset_is_lost_and_can_be_made_again() -> None:
    async with (
        stepped_controller() as (_, ports),
        FaultProxy((HOST, ports.dashboard), HOST) as proxy,
        DashboardClient(proxy.host, proxy.port) as dashboard,
    ):
        await proxy.reset()
        with pytest.raises(DashboardError) as raised:
            await dashboard.robot_mode()
        assert raised.value.reason is DashboardErrorReason.LOST

        await dashboard.connect()
        assert await dashboard.robot_mode() == "RUNNING"


async def test_a_late_answer_is_not_taken_for_the_next_one() -> None:
    async with (
        stepped_controller() as (_, ports),
        FaultProxy((HOST, ports.dashboard), HOST) as proxy,
        DashboardClient(proxy.host, proxy.port, reply_timeout_s=0.5) as dashboard,
    ):
        proxy.to_client.stall()
        with pytest.raises(DashboardError) as raised:
            await dashboard.robot_mode()
        assert raised.value.reason is DashboardErrorReason.TIMEOUT

        proxy.to_client.resume()
        await dashboard.connect()
        assert await dashboard.safety_status() == "NORMAL"
