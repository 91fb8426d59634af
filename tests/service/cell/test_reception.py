"""A flood of what is refused leaves a few lines in the journal, and none of it is lost from the count."""

import pytest

from service.cell.reception import NotACommandError, Reception
from service.cell.remarks import BURST, PERIOD_S, Remarks
from service.messages import StartRequest


def test_70_refusals_are_told_at_once_then_one_per_period_with_their_count() -> None:
    lines: list[str] = []
    now = [0.0]
    reception = Reception(Remarks(lines.append, lambda: now[0]).note)

    def refuse() -> None:
        with pytest.raises(NotACommandError):
            reception.command("cell/**" + "x" * 1000, "cell/a/command/start", b"", StartRequest)

    for _ in range(1000):
        refuse()
    assert len(lines) == BURST
    now[0] = PERIOD_S
    refuse()
    assert len(lines) == BURST + 1
    assert lines[-1].endswith(f"; {1000 - BURST} more before it")
    assert all(len(line) < 300 for line in lines), "a stranger's text is quoted in part"
