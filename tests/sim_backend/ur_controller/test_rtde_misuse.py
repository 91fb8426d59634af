"""RTDE of the emulated controller against clients that err, flood or do not read."""

import random
import struct
from collections.abc import Iterator
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_backend.ur_controller import listener
from tests.sim_backend.ur_controller.rtde_bench import Bench
from wire.rtde.fields import INPUTS

OUTPUTS_OF_V2 = struct.pack(">d", 500.0) + b"actual_q"


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.close()


def test_no_bits_in_the_inputs_stop_the_controller(bench: Bench) -> None:
    writer, reader = bench.peer(), bench.peer()
    registers = [name for name in INPUTS if "register" in name and (name[-2:].isdigit() and int(name[-2:]) >= 24)]
    others = [name for name in INPUTS if "register" not in name]
    recipes = [registers[at : at + 40] for at in range(0, len(registers), 40)] + [others]
    for names in recipes:
        assert writer.inputs(",".join(names))[0] > 0
    reader.begin("timestamp," + ",".join(registers[:60]))
    draw = random.Random(5)
    for _ in range(100):
        for recipe_id, names in enumerate(recipes, start=1):
            size = struct.calcsize(">" + "".join(f"{INPUTS[name].count}{INPUTS[name].letter}" for name in names))
            writer.send("U", bytes([recipe_id]) + draw.randbytes(size))
        bench.tick()
        kind, payload = reader.receive()
        assert (kind, struct.unpack_from(">d", payload, 1)[0]) == ("U", bench.controller.time_s)
    assert any(payload[9:])


def test_a_program_cannot_put_a_number_into_a_register_that_no_package_could_carry(bench: Bench) -> None:
    peer = bench.peer()
    peer.begin("output_int_register_24,output_double_register_24")
    for number in ("2147483648", "-2147483649", "1e300"):
        bench.controller.run_script(f"def p():\n  write_output_integer_register(24, {number})\n  sync()\nend\n")
        bench.tick(20)
        assert len(peer.settle()) >= 20


def test_requests_may_come_in_pieces_and_several_at_once(bench: Bench) -> None:
    peer = bench.peer()
    names = b"timestamp"
    stream = b"\x00\x05V\x00\x02" + struct.pack(">HBd", 3 + 8 + len(names), ord("O"), 500.0) + names + b"\x00\x03S"
    for at in range(len(stream) - 4):
        peer.socket.sendall(stream[at : at + 1])
        bench.loop.poll()
    peer.socket.sendall(stream[-4:] + b"\x00\x03P")
    assert [peer.receive() for _ in range(4)] == [("V", b"\x01"), ("O", b"\x01DOUBLE"), ("S", b"\x01"), ("P", b"\x01")]


@pytest.mark.parametrize(
    "stream",
    [
        b"\x00\x02V",
        b"\x00\x00\x00\x00",
        b"\xff\xffO" + bytes(100),
        b"\x10\x01O",
        b"\x00\x03?",
        b"\x00\x04V\x00",
        b"\x00\x05M\x05\x00",
        b"GET / HTTP/1.1\r\n\r\n",
    ],
    ids=["short", "zero", "long", "beyond the limit", "no type", "V", "M", "HTTP"],
)
def test_what_is_no_rtde_ends_the_connection_and_no_other(bench: Bench, stream: bytes) -> None:
    other, peer = bench.peer(), bench.peer()
    other.begin("timestamp")
    peer.inputs("input_int_register_24")
    peer.socket.sendall(stream)
    assert peer.is_dropped()
    assert other.inputs("input_int_register_24")[0] == 1
    bench.tick()
    assert other.data("d")[0] == bench.controller.time_s


def test_a_data_package_that_does_not_fit_its_recipe_is_ignored(bench: Bench) -> None:
    peer = bench.peer()
    peer.inputs("input_int_register_24")
    peer.socket.sendall(b"\x00\x05U\x01\x00" + b"\x00\x08U\x01\x00\x00\x00\x07")
    assert not peer.is_dropped()
    for _ in range(10):  # inputs have a latency
        bench.tick()
    assert bench.outputs.getters["input_int_register_24"]() == 7


@settings(max_examples=150)
@given(
    st.lists(
        st.one_of(
            st.binary(max_size=40),
            st.builds(
                lambda kind, payload: struct.pack(">HB", 3 + len(payload), kind) + payload,
                st.sampled_from(list(b"VvMUOISP")),
                st.one_of(
                    st.binary(max_size=60),
                    st.sampled_from(
                        [
                            b"\x00\x02",
                            b"\x00\x01",
                            b"timestamp",
                            b"input_int_register_24",
                            struct.pack(">d", 500) + b"actual_q",
                        ]
                    ),
                ),
            ),
        ),
        max_size=8,
    )
)
def test_no_bytes_of_a_client_stop_the_controller(shared: Bench, chunks: list[bytes]) -> None:
    peer = shared.peer()
    for chunk in chunks:
        try:
            peer.socket.sendall(chunk)
        except (BrokenPipeError, ConnectionResetError):
            break
        shared.loop.poll()
    shared.tick()
    peer.socket.close()
    shared.peers.remove(peer)
    shared.tick()


@pytest.fixture(scope="module")
def shared() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.close()


def test_a_slow_reader_misses_whole_packages_and_gets_the_newest_next(bench: Bench) -> None:
    slow = bench.peer(receive_buffer=4096)
    slow.begin("timestamp," + ",".join(f"output_double_register_{i}" for i in range(48)))
    while bench.service.skipped < 20:
        bench.tick()
    packages = slow.settle()
    bench.tick()
    packages += slow.settle()
    assert {(kind, len(payload)) for kind, payload in packages} == {("U", 1 + 49 * 8)}
    stamps = [struct.unpack_from(">d", payload, 1)[0] for _, payload in packages]
    steps = [round((b - a) * 500) for a, b in pairwise(stamps)]
    assert stamps[-1] == bench.controller.time_s
    assert min(steps) == 1
    assert sum(steps) - len(steps) == bench.service.skipped


def test_a_reader_that_takes_nothing_for_ten_seconds_is_dropped_and_its_inputs_are_free(bench: Bench) -> None:
    stuck, other = bench.peer(receive_buffer=4096), bench.peer()
    stuck.begin(",".join(f"output_double_register_{i}" for i in range(48)))
    stuck.inputs("input_int_register_24")
    while bench.service.skipped == 0:
        bench.tick()
    bench.now_s += listener.DRAIN_TIMEOUT_S + 0.1
    bench.tick(2)
    assert other.inputs("input_int_register_24")[0] == 1
