"""States as the driver reads them by their offsets, against numpy's access by field."""

import math

import numpy as np
import pytest

from service.drivers.sim_wire import CommandWriter, read_sample
from wire import records
from wire.arrays import RecordArray


def state(seed: int) -> RecordArray:
    """Return a state whose numbers are all different."""
    record = records.new(records.STATE, records.Kind.STATE)
    draws = np.random.default_rng(seed)
    for name in records.STATE.names or ():
        kind = records.STATE[name]
        if kind.base.kind == "f":
            record[name] = draws.normal(size=(1, *kind.shape))
    for number, name in enumerate(("epoch", "episode", "seq", "command_seq", "client")):
        record[name] = draws.integers(1, 2**63) + number
    record["program"], record["stop_reason"] = draws.integers(0, 4), draws.integers(0, 10)
    record["robot_mode"], record["safety_mode"], record["saturated"] = 7, -3, draws.integers(0, 2)
    return record


@pytest.mark.parametrize("seed", range(20))
def test_every_field_of_a_state_reaches_the_sample(seed: int) -> None:
    record = state(seed)
    sample, row = read_sample(record.tobytes(), 12.5), record[0]
    arrays = ("q", "qd", "tcp_position", "tcp_rotvec", "tcp_velocity", "wrench", "unzeroed", "ft_raw", "joint_force")
    for name in (*arrays, "hole_estimate"):
        assert np.array_equal(getattr(sample, name), row[name]), name
    for name in ("epoch", "episode", "seq", "time_s", "robot_mode", "safety_mode", "command_seq"):
        assert getattr(sample, name) == row[name], name
    assert (sample.program, sample.stop_reason) == (row["program"], row["stop_reason"])
    assert sample.program.name
    assert sample.stop_reason.name
    assert sample.saturated is bool(row["saturated"])
    assert sample.peak_force_n == row["peak_force"]
    assert sample.arrival_s == 12.5


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_an_estimate_that_is_not_finite_is_none(bad: float) -> None:
    record = state(0)
    record["hole_estimate"][0, 1] = bad
    assert read_sample(record.tobytes(), 0.0).hole_estimate is None


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("magic", 1, "wrong magic"),
        ("version", 1, "schema version 1"),
        ("kind", records.Kind.STOP, "kind 4 on a state key"),
        ("program", 77, "77 is not a valid Program"),
        ("stop_reason", 99, "99 is not a valid StopReason"),
    ],
)
def test_a_state_that_does_not_follow_the_schema_is_refused(field: str, value: int, said: str) -> None:
    record = state(0)
    record[field] = value
    with pytest.raises(records.WireError, match=said):
        read_sample(record.tobytes(), 0.0)


@pytest.mark.parametrize("length", [0, 1, 511, 513, 1024])
def test_anything_but_one_state_is_refused(length: int) -> None:
    with pytest.raises(records.WireError, match=f"{length} bytes are not one state of 512 bytes"):
        read_sample((2 * state(0).tobytes())[:length].ljust(length, b"\0"), 0.0)


def test_a_command_has_its_kind_its_sender_and_the_next_number() -> None:
    writer = CommandWriter()
    writer.epoch, writer.client = 2**63 + 5, 2**62 + 7
    kinds = records.Kind.STOP, records.Kind.STOP_BLIND, records.Kind.ZERO_FT, records.Kind.UNLOCK
    commands = writer.stop(), writer.stop(blind=True), writer.zero_ft(), writer.unlock()
    for number, (kind, command) in enumerate(zip(kinds, commands, strict=True), start=1):
        whole = records.new(records.COMMAND, kind)
        whole["client"], whole["epoch"], whole["seq"] = writer.client, writer.epoch, number
        assert command.tobytes() == whole.tobytes()
    assert writer.seq == 4
