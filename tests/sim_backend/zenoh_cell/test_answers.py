"""Answers of a real cell to requests good and bad, without a transport."""

import contextlib
import itertools
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_backend.holding import Holding
from sim_backend.requests import RequestError
from sim_backend.zenoh_cell import answers
from sim_backend.zenoh_cell.cell import SimulatedCell
from wire import records

CELL = SimulatedCell("tr", epoch=7)
HOLDING = Holding()
WORD = json.loads(HOLDING.claim("", b'{"cell": "a", "host": "b", "pid": 1}'))["client"]
SEQ = itertools.count(1)
COMMAND_KINDS = [kind for kind in records.Kind if kind not in (records.Kind.STATE, records.Kind.CAMERA)]


def signed(*parameters: str) -> str:
    return ";".join((*parameters, f"client={WORD}", f"seq={next(SEQ)}"))


def advance(ticks: str, payload: bytes = b"") -> bytes:
    return answers.advance(CELL, HOLDING, signed(*filter(None, [ticks])), payload)


def reset(document: bytes) -> bytes:
    return answers.reset(CELL, HOLDING, signed(), document)


def command(kind: records.Kind, **fields: object) -> np.ndarray:
    record = records.new(records.COMMAND, kind)
    record["client"], record["seq"] = WORD, next(SEQ)
    for name, value in fields.items():
        record[name] = value
    return record


def snapshot() -> bytes:
    return CELL.state().tobytes()


def test_advance_answers_one_state_per_tick() -> None:
    before = CELL.state()["seq"][0]
    states = records.decode(advance("ticks=7", b""), records.STATE)
    assert states["seq"].tolist() == list(range(before + 1, before + 8))
    assert (states["kind"] == records.Kind.STATE).all()


@pytest.mark.parametrize(
    "parameters",
    [
        *["", "ticks", "ticks=", "ticks=0", "ticks=-1", "ticks=1.5", "ticks=1e3", "ticks=5001", "ticks=" + "9" * 5000],
        *["tick=1", "ticks=1;ticks=2", "ticks=1;commands=2", "ticks=٣", "ticks= 1"],
    ],
)
def test_a_number_of_ticks_that_makes_no_sense_is_refused_and_changes_nothing(parameters: str) -> None:
    before = snapshot()
    with pytest.raises(RequestError, match="ticks=N with N from 1 to 5000"):
        advance(parameters, command(records.Kind.STOP).tobytes())
    assert snapshot() == before


def test_one_bad_command_among_good_ones_stops_them_all() -> None:
    before = snapshot()
    good, bad = command(records.Kind.STOP), command(records.Kind.STOP, version=records.VERSION + 1)
    with pytest.raises(RequestError, match=f"schema version {records.VERSION + 1}"):
        advance("ticks=1", good.tobytes() + bad.tobytes())
    assert snapshot() == before


@pytest.mark.parametrize("kind", [0, records.Kind.STATE, 7, 65535])
def test_a_kind_that_is_no_command_is_named(kind: int) -> None:
    record = command(records.Kind.STOP)
    record["kind"] = kind
    with pytest.raises(records.WireError, match=f"kind {int(kind)} is not a command"):
        answers.read_commands(record.tobytes())


def test_more_commands_than_one_message_may_hold_are_refused() -> None:
    payload = command(records.Kind.STOP).tobytes() * (answers.MAX_COMMANDS + 1)
    with pytest.raises(records.WireError, match="at most 1000"):
        answers.read_commands(payload)


@pytest.mark.parametrize(
    ("document", "named"),
    [
        ('{"seed": 1, "colour": "red"}', "colour"),
        ("{}", "seed"),
        ('{"seed": -1}', "task.seed"),
        ('{"seed": true}', "task.seed"),
        ('{"seed": 1.5}', "task.seed"),
        ('{"seed": 1, "part": "hexagon"}', "task.part"),
        ('{"seed": 1, "part": ["tr"]}', "task.part"),
        ('{"seed": 1, "clearance_m": 0.1}', "task.clearance_m"),
        ('{"seed": 1, "clearance_m": "2 mm"}', "task.clearance_m"),
        ('{"seed": 1, "clearance_m": NaN}', "task.clearance_m"),
        ('{"seed": 1, "clearance_m": null}', "task.clearance_m"),
        ('{"seed": 1, "conditions": "hard"}', "task.conditions"),
        ('{"seed": 1, "randomise_plant": "no"}', "task.randomise_plant"),
        ("[1]", "JSON object"),
        ("", "not JSON"),
        ("[" * 4000, "not JSON"),
        ("1" * 4400, "4400 bytes"),
    ],
)
def test_a_task_that_no_world_can_be_built_from_is_named_and_changes_nothing(document: str, named: str) -> None:
    before = snapshot()
    with pytest.raises(RequestError, match=named):
        reset(document.encode())
    assert snapshot() == before


def test_a_reset_lays_out_the_world_that_its_seed_means() -> None:
    reset(b'{"seed": 11}')
    first = CELL.truth()["hole_position"]
    reset(b'{"seed": 12}')
    second = CELL.truth()["hole_position"]
    reset(b'{"seed": 11}')
    assert first == CELL.truth()["hole_position"] != second


def test_truth_is_json_of_finite_numbers() -> None:
    document = json.loads(answers.truth(CELL), parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert math.isfinite(document["depth"])
    assert isinstance(document["contained"], bool)


@settings(max_examples=200, deadline=None)
@given(parameters=st.text(max_size=30), payload=st.binary(max_size=700))
def test_no_bytes_break_the_answers(parameters: str, payload: bytes) -> None:
    for answer in (
        lambda: advance(parameters, payload),
        lambda: advance("ticks=1", payload),
        lambda: reset(payload),
    ):
        with contextlib.suppress(RequestError):
            records.decode(answer(), records.STATE)


@st.composite
def addressed_commands(draw: st.DrawFn) -> np.ndarray:
    """A command that this world reads on: sane here and there, so that it gets past the first check."""
    kind = draw(st.sampled_from(COMMAND_KINDS))
    record = command(kind, epoch=CELL.epoch, client=draw(st.integers(1, 2)), seq=draw(st.integers(0, 2**64 - 1)))
    sane = {"position": CELL.state()["tcp_position"], "rotvec": CELL.state()["tcp_rotvec"], "workspace": [[-1], [1]]}
    for name in records.COMMAND.names[6:]:
        record[name] = sane.get(name, 1.0)
        if draw(st.booleans()):
            number = st.sampled_from([np.nan, np.inf, -np.inf, -1.0, 0.0, 1e-300, 1e300]) | st.floats()
            values = record[name].reshape(-1)
            values[draw(st.integers(0, len(values) - 1))] = draw(number)
    return record


@settings(max_examples=300, deadline=None)
@given(st.lists(addressed_commands(), max_size=5))
def test_no_content_of_commands_breaks_the_world(commands: list[np.ndarray]) -> None:
    state = records.decode(advance("ticks=3", b"".join(c.tobytes() for c in commands)), records.STATE)
    for name in ("q", "wrench", "target_position", "target_rotvec", "peak_force"):
        assert np.isfinite(state[name]).all(), name


@settings(max_examples=200, deadline=None)
@given(
    document=st.fixed_dictionaries(
        {"seed": st.integers(0, 2**70)},
        optional={
            "part": st.sampled_from(["tr", "cir"]),
            "clearance_m": st.floats() | st.integers() | st.none() | st.text(max_size=3),
            "conditions": st.sampled_from(["standard", "easy", "search", "stiff", "transfer"]) | st.none(),
            "randomise_plant": st.booleans() | st.integers(),
        },
    )
)
def test_no_task_breaks_the_world(document: dict[str, object]) -> None:
    with contextlib.suppress(RequestError):
        reset(json.dumps(document).encode())
    state = records.decode(advance("ticks=1", b""), records.STATE)
    assert np.isfinite(state["tcp_position"]).all()
