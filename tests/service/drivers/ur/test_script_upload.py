import asyncio
import random
from collections.abc import AsyncIterator, Callable

import pytest

from service.drivers.ur.script_upload import UploadError, UploadErrorReason, upload
from sim_backend.ur_controller.controller import Controller
from tests.fault_proxy import FaultProxy, Spoil, chunked, halved
from tests.service.drivers.ur.stepped import HOST, stepped_controller
from wire.primary import messages, state
from wire.primary.messages import encode_message
from wire.primary.packages import PackageType, frame
from wire.rtde.modes import RuntimeState

WAIT = "def wait():\n  while True:\n    sync()\n  end\nend\n"
Robot = tuple[Controller, int]


@pytest.fixture
async def robot() -> AsyncIterator[Robot]:
    async with stepped_controller() as (controller, ports):
        yield controller, ports.primary


async def test_it_returns_when_the_program_runs(robot: Robot) -> None:
    controller, port = robot

    await upload(HOST, port, WAIT)

    assert controller.runtime_state is RuntimeState.PLAYING
    assert controller.program_name == "wait"


async def test_the_text_need_not_end_with_a_line_s_end(robot: Robot) -> None:
    controller, port = robot

    await upload(HOST, port, "# ours\n\n" + WAIT.rstrip())

    assert controller.runtime_state is RuntimeState.PLAYING


async def test_it_replaces_the_program_that_runs(robot: Robot) -> None:
    controller, port = robot
    await upload(HOST, port, WAIT)

    await upload(HOST, port, WAIT.replace("wait", "other"))

    assert controller.program_name == "other"
    assert controller.runtime_state is RuntimeState.PLAYING


async def test_an_unknown_name_has_its_line_in_the_given_text(robot: Robot) -> None:
    controller, port = robot
    text = "# a program\n# of two comments\ndef bad():\n  nothing_there()\nend\n"

    with pytest.raises(UploadError, match="line 4, column 3: compile_error_name_not_found:nothing_there:") as raised:
        await upload(HOST, port, text)

    assert (raised.value.reason, raised.value.line, raised.value.column) == (UploadErrorReason.SCRIPT, 4, 3)
    assert controller.runtime_state is RuntimeState.STOPPED


async def test_a_syntax_error_has_its_line(robot: Robot) -> None:
    with pytest.raises(UploadError) as raised:
        await upload(HOST, robot[1], "def bad():\n  x = = 1\nend\n")

    assert (raised.value.reason, raised.value.line) == (UploadErrorReason.SCRIPT, 2)


async def test_local_control_is_told(robot: Robot) -> None:
    robot[0].remote_control = False

    with pytest.raises(UploadError, match="switch the robot to remote control") as raised:
        await upload(HOST, robot[1], WAIT)

    assert raised.value.reason is UploadErrorReason.NOT_REMOTE


async def test_an_arm_that_cannot_run_gets_no_program(robot: Robot) -> None:
    controller, port = robot
    controller.protective_stop("test")
    with pytest.raises(UploadError, match="protective stop") as raised:
        await upload(HOST, port, WAIT)
    assert raised.value.reason is UploadErrorReason.NOT_RUNNING

    controller.power_off()
    with pytest.raises(UploadError, match="protective stop"):
        await upload(HOST, port, WAIT)
    controller.restart_safety()
    with pytest.raises(UploadError, match="power it on and release the brakes"):
        await upload(HOST, port, WAIT)
    controller.press_emergency_stop()
    with pytest.raises(UploadError, match="emergency-stopped"):
        await upload(HOST, port, WAIT)


@pytest.mark.parametrize("text", ["", "stopj(2.0)\n", "sec io():\nend\n", "def no_brackets:\nend\n"])
async def test_only_a_named_program_is_taken(text: str) -> None:
    with pytest.raises(ValueError, match="begins with `def name"):
        await upload(HOST, 9, text)


async def test_no_controller_is_named() -> None:
    with pytest.raises(UploadError, match=r"primary port 127\.0\.0\.25:9") as raised:
        await upload(HOST, 9, WAIT)

    assert raised.value.reason is UploadErrorReason.UNREACHABLE


RUNNING = frame(
    PackageType.ROBOT_STATE,
    state.encode_state([state.RobotMode(0, True, True, True, False, False, False, False, robot_mode=7)]),
)


def message(content: messages.Message) -> bytes:
    return frame(PackageType.ROBOT_MESSAGE, encode_message(content))


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (b"", UploadErrorReason.LOST),
        (b"\x00\x00\x00\x01\x10", UploadErrorReason.LOST),
        (b"SSH-2.0-OpenSSH_9.6\r\n", UploadErrorReason.LOST),
        (message(messages.ErrorCode(153, 1, messages.ReportLevel.FAULT, "drives")), UploadErrorReason.CONTROLLER),
        (message(messages.RuntimeException(0, 0, "compile_error")), UploadErrorReason.SCRIPT),
        (message(messages.Key(messages.PROGRAM_STARTED, "somebody_else_s")), UploadErrorReason.LOST),
        (message(messages.ErrorCode(160, 0, messages.ReportLevel.WARNING)), UploadErrorReason.LOST),
    ],
)
async def test_a_start_that_is_not_confirmed_is_an_error(answer: bytes, reason: UploadErrorReason) -> None:
    async def speak(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(RUNNING)
        await reader.readuntil(b"\nend\n")
        writer.write(answer)
        writer.close()

    async with await asyncio.start_server(speak, HOST, 0) as server:
        with pytest.raises(UploadError) as raised:
            await upload(HOST, server.sockets[0].getsockname()[1], WAIT)

    assert raised.value.reason is reason


async def test_silence_ends_in_a_timeout() -> None:
    async def speak(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(RUNNING)
        await reader.read()
        writer.close()

    async with await asyncio.start_server(speak, HOST, 0) as server:
        with pytest.raises(UploadError, match=r"did not report within 0\.1 s that `wait` runs") as raised:
            await upload(HOST, server.sockets[0].getsockname()[1], WAIT, timeout_s=0.1)

    assert raised.value.reason is UploadErrorReason.TIMEOUT


@pytest.mark.parametrize("spoil", [lambda: chunked(random.Random(0), 40), halved])
async def test_a_program_in_pieces_runs_and_is_confirmed_in_pieces(robot: Robot, spoil: Callable[[], Spoil]) -> None:
    controller, port = robot
    async with FaultProxy((HOST, port), HOST) as proxy:
        proxy.to_client.spoil = spoil()
        proxy.to_service.spoil = chunked(random.Random(1), 3)
        await upload(proxy.host, proxy.port, WAIT)

    assert controller.runtime_state is RuntimeState.PLAYING


async def test_a_program_that_a_reset_cut_short_does_not_run(robot: Robot) -> None:
    controller, port = robot
    async with FaultProxy((HOST, port), HOST) as proxy:
        proxy.to_service.spoil = lambda program: [program[: len(program) // 2]]
        uploading = asyncio.ensure_future(upload(proxy.host, proxy.port, WAIT))
        while not controller.time_s > 61.0:
            await asyncio.sleep(0)
        await proxy.reset()
        with pytest.raises(UploadError) as raised:
            await uploading

    assert raised.value.reason is UploadErrorReason.LOST
    assert controller.program_name == ""
