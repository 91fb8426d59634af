"""RTDE of the emulated controller over real sockets: bytes in, bytes out, one tick at a time."""

import math
import struct
from collections.abc import Iterator
from itertools import pairwise

import pytest

from tests.sim_backend.ur_controller.rtde_bench import Bench
from wire.rtde.fields import INPUTS, OUTPUTS, SINCE


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.close()


# --- versions


def test_versions_are_asked_and_answered_in_these_bytes(bench: Bench) -> None:
    peer = bench.peer()
    peer.socket.sendall(b"\x00\x05V\x00\x02")
    assert peer.receive() == ("V", b"\x01")
    major, minor, *_ = struct.unpack(">4I", peer.ask("v"))
    assert (major, minor) == (5, 21)


@pytest.mark.parametrize(("version", "accepted"), [(0, 0), (1, 1), (2, 1), (3, 0), (0xFFFF, 0)])
def test_protocol_versions_1_and_2_are_spoken(bench: Bench, version: int, accepted: int) -> None:
    assert bench.peer().ask("V", struct.pack(">H", version)) == bytes([accepted])


# --- outputs


def test_data_are_what_the_robot_does_at_that_tick(bench: Bench) -> None:
    peer = bench.peer()
    peer.ask("V", b"\x00\x02")
    assert peer.outputs("timestamp,actual_q,robot_mode,payload_cog") == (1, ["DOUBLE", "VECTOR6D", "INT32", "VECTOR3D"])
    assert peer.ask("S") == b"\x01"
    bench.tick(3)
    for _ in range(2):
        peer.data("7di3d")
    timestamp, *rest = peer.data("7di3d")
    assert timestamp == bench.controller.time_s
    assert rest[:6] == pytest.approx(list(bench.controller.plant.q), abs=1e-12)
    assert rest[6] == 7
    assert rest[7:] == pytest.approx(bench.controller.plant.payload_cog)


def test_timestamps_lie_on_the_grid_of_2_ms(bench: Bench) -> None:
    peer = bench.peer()
    peer.begin("timestamp")
    bench.tick(200)
    stamps = [peer.data("d")[0] for _ in range(200)]
    assert all(abs(stamp * 500 - round(stamp * 500)) < 1e-6 for stamp in stamps)
    assert [round((b - a) * 500) for a, b in pairwise(stamps)] == [1] * 199
    assert stamps[0] >= 40


@pytest.mark.parametrize(
    ("frequency_hz", "every"), [(500, 1), (300, 1), (250, 2), (200, 2), (125, 4), (99, 5), (1, 500)]
)
def test_a_frequency_gives_every_whole_number_of_ticks(bench: Bench, frequency_hz: float, every: int) -> None:
    peer = bench.peer()
    peer.begin("timestamp", frequency_hz)
    bench.tick(2 * every)
    first, second = (peer.data("d")[0] for _ in range(2))
    assert round((second - first) * 500) == every
    assert peer.settle() == []


@pytest.mark.parametrize("frequency_hz", [0.0, 0.99, -125.0, 500.1, math.inf, math.nan])
def test_a_frequency_out_of_range_is_refused(bench: Bench, frequency_hz: float) -> None:
    peer = bench.peer()
    peer.ask("V", b"\x00\x02")
    assert peer.outputs("timestamp", frequency_hz) == (0, ["DOUBLE"])
    assert peer.ask("S") == b"\x00"


def test_version_1_has_neither_frequency_nor_recipe_id(bench: Bench) -> None:
    peer = bench.peer()  # which asks for no version
    assert peer.ask("O", b"timestamp,robot_mode") == b"DOUBLE,INT32"
    assert peer.ask("S") == b"\x01"
    bench.tick(2)
    for time_s in (bench.controller.time_s - 0.002, bench.controller.time_s):
        kind, payload = peer.receive()
        assert kind == "U"
        assert struct.unpack(">di", payload) == (pytest.approx(time_s, abs=1e-9), 7)


def test_a_comma_at_the_end_of_the_names_is_no_name(bench: Bench) -> None:
    peer = bench.peer()
    peer.ask("V", b"\x00\x02")
    assert peer.outputs("timestamp,robot_mode,") == (1, ["DOUBLE", "INT32"])
    assert peer.inputs("input_int_register_24,") == (1, ["INT32"])


@pytest.mark.parametrize("unknown", ["actual_Q", "timestamp ", "nonsense", "input_int_register_48", "control_step"])
def test_an_unknown_output_is_named_and_gives_no_recipe(bench: Bench, unknown: str) -> None:
    peer = bench.peer()
    peer.ask("V", b"\x00\x02")
    assert peer.outputs(f"timestamp,{unknown},actual_q") == (0, ["DOUBLE", "NOT_FOUND", "VECTOR6D"])
    assert peer.ask("S") == b"\x00"
    bench.tick(3)
    assert peer.settle() == []


def test_a_second_output_recipe_takes_the_place_of_the_first(bench: Bench) -> None:
    peer = bench.peer()
    peer.begin("timestamp,actual_q", 250)
    assert peer.outputs("timestamp", 500) == (1, ["DOUBLE"])
    bench.tick(2)
    first, second = (peer.data("d")[0] for _ in range(2))
    assert round((second - first) * 500) == 1


def test_a_second_output_recipe_that_is_refused_changes_nothing(bench: Bench) -> None:
    peer = bench.peer()
    peer.begin("timestamp")
    assert peer.outputs("nonsense")[0] == 0
    bench.tick()
    assert peer.data("d")[0] == bench.controller.time_s


def test_every_variable_of_this_version_can_be_had(bench: Bench) -> None:
    peer = bench.peer()
    peer.ask("V", b"\x00\x02")
    known = [name for name in OUTPUTS if SINCE.get(name, (0, 0, 0)) <= (5, 21, 0)]
    assert len(known) > 400
    batch: list[str] = []
    while known:
        batch.append(known.pop(0))
        if known and len(",".join([*batch, known[0]])) <= 2048:
            continue
        types = [OUTPUTS[name] for name in batch]
        assert peer.outputs(",".join(batch)) == (1, [kind.name for kind in types])
        assert peer.ask("S") == b"\x01"
        bench.tick()
        values = peer.data("".join(f"{kind.count}{kind.letter}" for kind in types))
        assert len(values) == sum(kind.count for kind in types)
        assert all(math.isfinite(value) for value in values)
        peer.ask("P")
        batch = []


def test_a_list_of_names_beyond_2048_bytes_is_refused(bench: Bench) -> None:
    peer = bench.peer()
    peer.ask("V", b"\x00\x02")
    names = ",".join(
        [f"output_double_register_{i}" for i in range(48)] + [f"input_double_register_{i}" for i in range(48)]
    )
    names = names[: names.rindex(",", 0, 2048)]
    assert peer.outputs(names)[0] == 1
    assert peer.outputs(f"{names},output_bit_register_64,output_bit_register_65")[0] == 0
    assert peer.inputs(",".join([f"input_double_register_{i}" for i in range(48)] * 2))[0] == 0


# --- start and pause


def test_without_outputs_there_is_nothing_to_start(bench: Bench) -> None:
    peer = bench.peer()
    peer.ask("V", b"\x00\x02")
    assert peer.ask("S") == b"\x00"


def test_data_flow_from_start_to_pause(bench: Bench) -> None:
    peer = bench.peer()
    assert peer.ask("P") == b"\x01"
    peer.begin("timestamp")
    assert peer.ask("P") == b"\x01"
    bench.tick(3)
    assert peer.settle() == []
    assert peer.ask("S") == b"\x01"
    bench.tick()
    assert peer.data("d")[0] == bench.controller.time_s


def test_clients_have_their_own_recipes_and_rates(bench: Bench) -> None:
    fast, slow = bench.peer(), bench.peer()
    fast.begin("timestamp", 500)
    slow.begin("actual_q,timestamp", 125)
    bench.tick(8)
    assert len(fast.settle()) == 8
    packages = slow.settle()
    assert [len(payload) for _, payload in packages] == [1 + 7 * 8] * 2


# --- inputs


def test_input_recipes_are_numbered_from_1(bench: Bench) -> None:
    peer = bench.peer()
    assert peer.inputs("input_int_register_24") == (1, ["INT32"])
    assert peer.inputs("nonsense,input_int_register_24") == (0, ["NOT_FOUND", "INT32"])
    assert peer.inputs("input_int_register_24,input_double_register_24") == (2, ["INT32", "DOUBLE"])


def test_a_client_has_at_most_255_input_recipes(bench: Bench) -> None:
    peer = bench.peer()
    assert [peer.inputs("input_int_register_24")[0] for _ in range(257)] == [*range(1, 256), 0, 0]


def test_every_input_is_known_by_its_type(bench: Bench) -> None:
    peer = bench.peer()
    for name, kind in INPUTS.items():
        assert peer.inputs(name)[1] == [kind.name]


def test_an_input_is_one_clients_until_it_leaves(bench: Bench) -> None:
    first, second = bench.peer(), bench.peer()
    assert first.inputs("input_int_register_24,input_double_register_24")[0] == 1
    assert first.inputs("input_int_register_24")[0] == 2
    assert second.inputs("input_int_register_25,input_int_register_24") == (0, ["INT32", "IN_USE"])
    assert first.inputs("input_int_register_25")[0] == 3, "what was refused has reserved something"
    first.socket.close()
    bench.tick()
    assert second.inputs("input_int_register_24,input_int_register_25,input_double_register_24")[0] == 1


def test_inputs_arrive_and_stay_without_a_start(bench: Bench) -> None:
    writer, reader = bench.peer(), bench.peer()
    reader.begin("input_int_register_24,input_double_register_25")
    assert writer.inputs("input_int_register_24,input_double_register_25")[0] == 1
    assert writer.inputs("input_int_register_24")[0] == 2
    writer.send("U", struct.pack(">Bid", 1, -7, 0.25))
    writer.settle()
    bench.tick(10)
    writer.send("U", struct.pack(">Bi", 2, 2**31 - 1))
    writer.settle()
    bench.tick(10)
    values = [struct.unpack(">id", payload[1:]) for _, payload in reader.settle()]
    assert values[-1] == (2**31 - 1, 0.25)
    assert (-7, 0.25) in values


def test_data_of_a_recipe_never_agreed_are_ignored_and_said_after_the_start_only(bench: Bench) -> None:
    peer = bench.peer()
    peer.ask("V", b"\x00\x02")
    for payload in (b"", b"\x00", b"\x01\x00\x00\x00\x05"):
        peer.send("U", payload)
    assert peer.settle() == []
    peer.begin("timestamp")
    peer.send("U", b"\x07\x00\x00\x00\x05")
    ((kind, payload),) = peer.settle()
    assert kind == "M"
    length = payload[0]
    assert "recipe 7" in payload[1 : 1 + length].decode()
    assert payload[-1] == 1
    assert len(payload) == 1 + length + 1 + payload[1 + length] + 1


# --- text messages


def test_a_program_that_does_not_compile_is_told_to_started_clients_of_version_2(bench: Bench) -> None:
    started, early, old = bench.peer(), bench.peer(), bench.peer()
    started.begin("timestamp")
    early.ask("V", b"\x00\x02")
    old.ask("O", b"timestamp")
    old.ask("S")
    bench.controller.run_script("def broken():\n  x = (1\nend\n")
    bench.tick()
    assert [kind for kind, _ in started.settle()].count("M") == 1
    assert [kind for kind, _ in early.settle()] == []
    assert [kind for kind, _ in old.settle()] == ["U"]
