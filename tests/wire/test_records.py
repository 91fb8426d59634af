import numpy as np
import pytest

from wire import records


def test_layouts_are_packed_and_start_with_the_same_header():
    for dtype in (records.STATE, records.COMMAND, records.CAMERA):
        assert dtype.names is not None
        assert dtype.names[:3] == ("magic", "version", "kind")
        assert sum(dtype[name].itemsize for name in dtype.names) == dtype.itemsize
        assert dtype.itemsize % 8 == 0


def test_a_record_survives_the_wire():
    record = records.new(records.COMMAND, records.Kind.TARGET)
    record["position"] = [0.1, -0.2, 0.3]
    record["seq"] = 2**63
    read = records.decode(record.tobytes(), records.COMMAND)
    assert read.shape == (1,)
    assert read[0] == record[0]
    assert records.Kind(int(read["kind"][0])) is records.Kind.TARGET


def test_several_records_are_read_in_order_and_cannot_be_written_to():
    states = np.repeat(records.new(records.STATE, records.Kind.STATE), 3)
    states["seq"] = [5, 6, 7]
    read = records.decode(states.tobytes(), records.STATE)
    assert read["seq"].tolist() == [5, 6, 7]
    with pytest.raises(ValueError, match="read-only"):
        read["seq"] = 0


def test_the_byte_order_of_the_wire_is_little_endian():
    assert records.new(records.STATE, records.Kind.STATE).tobytes()[:8] == b"DDSL" + bytes(
        [records.VERSION, 0, records.Kind.STATE, 0]
    )


@pytest.mark.parametrize("length", [0, 1, records.STATE.itemsize - 1, records.STATE.itemsize + 1])
def test_a_broken_length_is_refused(length):
    with pytest.raises(records.WireError, match=f"{length} bytes are not a whole number"):
        records.decode(bytes(length), records.STATE)


def test_a_foreign_or_newer_record_is_refused_even_behind_a_good_one():
    states = np.repeat(records.new(records.STATE, records.Kind.STATE), 2)
    states["version"][1] = records.VERSION + 1
    with pytest.raises(records.WireError, match="schema version"):
        records.decode(states.tobytes(), records.STATE)
    states["magic"][1] = 0
    with pytest.raises(records.WireError, match="wrong magic"):
        records.decode(states.tobytes(), records.STATE)
