"""The document about safety tells the states as the code has them."""

import re
from pathlib import Path

from service.cell.states import TRANSITIONS

DOCUMENT = Path(__file__).parents[2] / "docs/explanation/safety.md"


def test_the_states_are_those_of_the_code() -> None:
    rows = re.findall(r"^\| ([A-Z]+) \| ([A-Z, ]+) \|$", DOCUMENT.read_text(), re.MULTILINE)
    told = {state: sorted(others.split(", ")) for state, others in rows}
    assert told == {state.value: sorted(other.value for other in others) for state, others in TRANSITIONS.items()}
