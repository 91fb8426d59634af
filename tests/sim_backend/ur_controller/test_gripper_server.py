import socket
from collections.abc import Iterator

import pytest

from sim_backend.ur_controller.gripper_server import (
    ACTIVATION_RUNS,
    ACTIVE,
    ARRIVED,
    MET_CLOSING,
    MOVING,
    NO_FAULT,
    NOT_ACTIVATED,
    RELEASED,
    RELEASING,
    RESET,
    Gripper,
    GripperService,
)
from sim_backend.ur_controller.listener import Listener
from wire.records import TICK_S

HOST = "127.0.0.25"


def run(gripper: Gripper, time_s: float) -> None:
    for _ in range(round(time_s / TICK_S)):
        gripper.tick()


def move(gripper: Gripper, position: int, *, speed: int = 255, force: int = 0) -> float:
    """Move until at rest and return how long it took, s."""
    for name, value in {"POS": position, "SPE": speed, "FOR": force, "GTO": 1}.items():
        assert gripper.set(name, value)
    ticks = 0
    while gripper.get("OBJ") == MOVING:
        gripper.tick()
        ticks += 1
    return ticks * TICK_S


def test_it_is_closed_on_the_peg_and_holds_it_from_the_start() -> None:
    gripper = Gripper()

    assert gripper.get("STA") == ACTIVE
    assert gripper.get("OBJ") == MET_CLOSING
    assert gripper.get("POS") == 155  # 28 mm
    assert gripper.force_n == 20.0


def test_the_fingers_take_the_time_that_their_speed_asks() -> None:
    gripper = Gripper(None)

    assert move(gripper, 0, speed=255) == pytest.approx(85 / 150, abs=0.01)
    assert gripper.get("POS") == 3
    assert move(gripper, 255, speed=0) == pytest.approx(85 / 20, abs=0.01)
    assert gripper.get("POS") == 230
    assert gripper.get("PRE") == 255


def test_closing_stops_at_an_object_and_holds_it_with_the_force_asked() -> None:
    gripper = Gripper(None)
    move(gripper, 0)
    gripper.object_mm = 40.0

    move(gripper, 255, force=255)

    assert gripper.opening_mm == 40.0
    assert gripper.get("OBJ") == MET_CLOSING
    assert gripper.force_n == 235.0


def test_a_target_short_of_the_object_is_reached_without_it() -> None:
    gripper = Gripper(None)
    move(gripper, 0)
    gripper.object_mm = 40.0

    move(gripper, 100)

    assert gripper.get("OBJ") == ARRIVED
    assert gripper.get("POS") == 100
    assert gripper.force_n == 0.0


def test_a_lost_object_shows() -> None:
    gripper = Gripper()
    gripper.object_mm = None

    gripper.tick()
    assert gripper.get("OBJ") == MOVING
    run(gripper, 2.0)
    assert gripper.get("OBJ") == ARRIVED
    assert gripper.get("POS") == 230


def test_motion_waits_for_the_go_to_bit() -> None:
    gripper = Gripper(None)
    gripper.set("GTO", 0)
    gripper.set("POS", 0)
    run(gripper, 1.0)
    assert gripper.get("POS") == 230

    gripper.set("GTO", 1)
    run(gripper, 1.0)
    assert gripper.get("POS") == 3


def test_activation_opens_and_closes_the_fingers_and_takes_its_time() -> None:
    gripper = Gripper(None, is_active=False)
    assert gripper.get("STA") == RESET

    gripper.set("ACT", 1)
    seen: list[float] = []
    while gripper.get("STA") != ACTIVE:
        gripper.tick()
        seen.append(gripper.opening_mm)

    assert len(seen) * TICK_S == pytest.approx(2 * 85 / 150, abs=0.02)
    assert min(seen) == 0.0
    assert seen[-1] == 85.0


def test_a_motion_before_activation_is_a_fault_that_activation_ends() -> None:
    gripper = Gripper(None, is_active=False)
    gripper.set("GTO", 1)
    assert gripper.get("FLT") == NOT_ACTIVATED

    gripper.set("ACT", 1)
    gripper.set("GTO", 1)
    gripper.set("POS", 255)
    assert gripper.get("FLT") == ACTIVATION_RUNS
    run(gripper, 3.0)
    assert gripper.get("FLT") == NO_FAULT
    assert gripper.get("POS") == 230


def test_an_automatic_release_opens_slowly_and_needs_a_reset() -> None:
    gripper = Gripper()
    gripper.set("ARD", 1)
    gripper.set("ATR", 1)
    run(gripper, 1.0)
    assert gripper.get("FLT") == RELEASING
    assert gripper.opening_mm == pytest.approx(28.0 + 20.0, abs=0.1)
    run(gripper, 2.0)
    assert gripper.get("FLT") == RELEASED

    gripper.set("POS", 100)
    run(gripper, 1.0)
    assert gripper.opening_mm == 85.0
    gripper.set("ACT", 0)
    assert gripper.get("FLT") == NO_FAULT


@pytest.mark.parametrize(("name", "value"), [("POS", 256), ("POS", -1), ("ACT", 2), ("OBJ", 1), ("XYZ", 0)])
def test_what_cannot_be_written_is_refused(name: str, value: int) -> None:
    gripper = Gripper()
    before = gripper.get(name)

    assert not gripper.set(name, value)
    assert gripper.get(name) == before


@pytest.fixture
def peer() -> Iterator[tuple[Listener, socket.socket]]:
    listener = Listener()
    port = listener.serve(GripperService(Gripper(None)), HOST, 0)
    with socket.create_connection((HOST, port)) as peer:
        peer.setblocking(False)
        yield listener, peer
    listener.close()


def ask(peer: tuple[Listener, socket.socket], request: bytes) -> bytes:
    listener, client = peer
    client.sendall(request)
    for _ in range(1000):
        listener.poll()
        try:
            return client.recv(1024)
        except BlockingIOError:
            continue
    raise AssertionError(f"{request!r} was not answered")


def test_setting_is_acknowledged_in_three_bytes(peer: tuple[Listener, socket.socket]) -> None:
    assert ask(peer, b"SET POS 100 SPE 255 FOR 0 GTO 1\n") == b"ack"
    assert ask(peer, b"GET PRE\n") == b"PRE 100\n"


def test_the_fingers_move_with_the_ticks(peer: tuple[Listener, socket.socket]) -> None:
    ask(peer, b"SET POS 0 GTO 1\n")
    for _ in range(round(85 / 150 / TICK_S) + 2):
        peer[0].publish()

    assert ask(peer, b"GET POS\n") == b"POS 3\n"


def test_requests_in_one_piece_are_answered_in_one(peer: tuple[Listener, socket.socket]) -> None:
    assert ask(peer, b"GET ACT\nGET STA\nGET FLT\n") == b"ACT 1\nSTA 3\nFLT 0\n"


@pytest.mark.parametrize(
    "request_line",
    [
        b"GET XYZ\n",
        b"SET POS\n",
        b"SET POS 300\n",
        b"SET POS -1\n",
        b"hello\n",
        b"\xff\n",
        b"SET POS " + b"9" * 5000 + b"\n",
    ],
)
def test_nonsense_is_answered_with_a_question_mark(peer: tuple[Listener, socket.socket], request_line: bytes) -> None:
    assert ask(peer, request_line) == b"?\n"


def test_a_flood_without_a_line_s_end_is_cut_off(peer: tuple[Listener, socket.socket]) -> None:
    assert ask(peer, b"x" * 3000) == b""
