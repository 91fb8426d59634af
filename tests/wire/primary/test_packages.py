import itertools
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wire.primary.errors import PrimaryError, PrimaryErrorReason
from wire.primary.packages import LIMIT, PackageReader, PackageType, frame

CONTENTS = st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=40)), max_size=6)


def test_the_size_counts_its_own_header() -> None:
    assert frame(PackageType.ROBOT_MESSAGE, b"abc") == b"\x00\x00\x00\x08\x14abc"


@given(CONTENTS, st.lists(st.integers(0, 300)))
def test_packages_are_found_wherever_the_stream_is_cut(contents: list[tuple[int, bytes]], cuts: list[int]) -> None:
    stream = b"".join(frame(*content) for content in contents)
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    reader = PackageReader()

    found = [one for a, b in itertools.pairwise(edges) for one in reader.feed(stream[a:b])]

    assert found == contents


@pytest.mark.parametrize("size", [-1, 0, 4, LIMIT + 1, 2**31 - 1])
def test_a_size_that_no_package_has_ends_the_stream(size: int) -> None:
    reader = PackageReader()
    good = frame(20, b"good")

    found = reader.feed(good + struct.pack(">iB", size, 16))

    assert next(found) == (20, b"good")
    with pytest.raises(PrimaryError, match="claims") as raised:
        next(found)
    assert raised.value.reason is PrimaryErrorReason.FRAMING
