import numpy as np
import pytest

from wire import records as wire


def test_layouts_are_packed_and_start_with_the_same_header():
    for dtype in (wire.STATE, wire.COMMAND, wire.CAMERA):
        assert dtype.names is not None
        assert dtype.names[:3] == ("magic", "version", "kind")
        assert sum(dtype[name].itemsize for name in dtype.names) == dtype.itemsize
        assert dtype.itemsize % 8 == 0


def test_a_record_survives_the_wire():
    record = wire.new(wire.COMMAND, wire.Kind.TARGET)
    record["position"] = [0.1, -0.2, 0.3]
    record["seq"] = 2**63
    read = wire.decode(record.tobytes(), wire.COMMAND)
    assert read.shape == (1,)
    assert read[0] == record[0]
    assert wire.Kind(int(read["kind"][0])) is wire.Kind.TARGET


def test_several_records_are_read_in_order_and_cannot_be_written_to():
    records = np.repeat(wire.new(wire.STATE, wire.Kind.STATE), 3)
    records["seq"] = [5, 6, 7]
    read = wire.decode(records.tobytes(), wire.STATE)
    assert read["seq"].tolist() == [5, 6, 7]
    with pytest.raises(ValueError, match="read-only"):
        read["seq"] = 0


def test_the_byte_order_of_the_wire_is_little_endian():
    assert wire.new(wire.STATE, wire.Kind.STATE).tobytes()[:8] == b"DDSL" + bytes([wire.VERSION, 0, wire.Kind.STATE, 0])


@pytest.mark.parametrize("length", [0, 1, wire.STATE.itemsize - 1, wire.STATE.itemsize + 1])
def test_a_broken_length_is_refused(length):
    with pytest.raises(wire.WireError, match=f"{length} bytes are not a whole number"):
        wire.decode(bytes(length), wire.STATE)


def test_a_foreign_or_newer_record_is_refused_even_behind_a_good_one():
    records = np.repeat(wire.new(wire.STATE, wire.Kind.STATE), 2)
    records["version"][1] = wire.VERSION + 1
    with pytest.raises(wire.WireError, match="schema version"):
        wire.decode(records.tobytes(), wire.STATE)
    records["magic"][1] = 0
    with pytest.raises(wire.WireError, match="wrong magic"):
        wire.decode(records.tobytes(), wire.STATE)
