import re
from pathlib import Path

from service.faults import FaultCode

PAGE = Path(__file__).parents[2] / "docs/reference/faults.md"


def test_every_code_is_documented_once_and_none_that_does_not_exist() -> None:
    documented = re.findall(r"^\| `([A-Z_]+)` \|", PAGE.read_text(), re.MULTILINE)
    assert sorted(documented) == sorted(FaultCode)


def test_every_code_says_what_it_means_and_what_to_do() -> None:
    for line in PAGE.read_text().splitlines():
        if line.startswith("| `"):
            _, _, meaning, _, remedy, _ = re.split(r"(?<!\\)\|", line)
            assert len(meaning.strip()) > 20, line
            assert len(remedy.strip()) > 10, line
