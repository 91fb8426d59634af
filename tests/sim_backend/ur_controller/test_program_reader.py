import itertools
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_backend.ur_controller.program_reader import LIMIT, ProgramReader, ProgramTooLongError

MOVE = 'def move():\n  if True:\n    # the end of it\n    textmsg("while in the end")\n  end\n  sync()\nend'
SECONDARY = "sec io():\n  set_digital_out(0, True)\nend"


def read(*pieces: bytes) -> list[str]:
    reader = ProgramReader()
    return [program for piece in pieces for program in reader.feed(piece)]


def test_a_program_is_complete_at_its_own_end() -> None:
    reader = ProgramReader()

    assert list(reader.feed(MOVE[: MOVE.index("sync")].encode())) == []
    assert list(reader.feed(MOVE[MOVE.index("sync") :].encode())) == []
    assert list(reader.feed(b"\n")) == [MOVE]


@given(st.lists(st.integers(0, len(MOVE) + len(SECONDARY) + 1)))
def test_programs_are_found_wherever_the_stream_is_cut(cuts: list[int]) -> None:
    stream = f"{MOVE}\n{SECONDARY}\n".encode()
    edges = [0, *sorted(cuts), len(stream)]

    programs = read(*(stream[a:b] for a, b in itertools.pairwise(edges)))

    assert programs == [MOVE, SECONDARY]


def test_programs_on_one_line_are_told_apart() -> None:
    assert read(b"def a(): sync() end def b(): sync() end\n") == ["def a(): sync() end", " def b(): sync() end"]


def test_single_lines_are_programs_at_once_and_blank_ones_and_comments_are_none() -> None:
    assert read(b"\n# hello\npower on\n\nstopj(2.0) # slowly\n") == ["power on\n", "stopj(2.0) # slowly\n"]


def test_line_1_is_that_of_the_definition() -> None:
    assert read(b"\n\n# header\n\ndef f():\n  sync()\nend\n\n") == ["def f():\n  sync()\nend"]


def test_an_end_without_a_line_s_end_counts_when_the_client_closes() -> None:
    reader = ProgramReader()

    assert list(reader.feed(b"def f():\n  sync()\nend")) == []
    assert list(reader.finish()) == ["def f():\n  sync()\nend"]


@pytest.mark.parametrize("cut", [b"movej([0, 0, 0, 0, 0, 0], a=1", b"def f():\n  movej(", b"def f():\n if a:\n end"])
def test_what_a_broken_connection_cut_short_is_not_run(cut: bytes) -> None:
    reader = ProgramReader()

    assert list(reader.feed(cut)) == []
    assert list(reader.finish()) == []


def test_a_stray_end_is_a_line_for_the_compiler_to_refuse() -> None:
    assert read(b"end\nsync()\n") == ["end\n", "sync()\n"]


def test_names_that_hold_a_keyword_open_no_block() -> None:
    lines = ["end_force_mode()\n", "iffy = 1\n", "x = time().sec\n"]

    assert read("".join(lines).encode()) == lines


def test_the_control_program_is_one_program() -> None:
    source = Path("service/drivers/ur/control_program.urscript").read_text()

    assert len(read(source.encode() + b"\n")) == 1


def test_memory_is_bounded() -> None:
    reader = ProgramReader()

    assert list(reader.feed(b"x" * LIMIT)) == []
    with pytest.raises(ProgramTooLongError, match="without the end"):
        list(reader.feed(b"x"))


def test_many_programs_in_a_row_are_not_counted_together() -> None:
    reader = ProgramReader()

    programs = [
        program for _ in range(3 * LIMIT // 100_000) for program in reader.feed(b"#" + b" " * 100_000 + b"\nsync()\n")
    ]

    assert set(programs) == {"sync()\n"}
