"""The committed results are of the present sources: measured with them, or carried over to them by replay."""

from pathlib import Path

import pytest

from training.evaluation import provenance
from training.evaluation.results import RESULTS, Results

ROOT = Path(__file__).parents[3]
KINDS = ("*.json", "fresh-seeds/*.json", "panels/*/*.json")
FILES = sorted(path for kind in KINDS for path in (ROOT / RESULTS).glob(kind))


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_results_name_the_sources_that_would_play_their_episodes_today(path: Path) -> None:
    results = Results.load(path)
    assert results.sources == provenance.sources(), "play the episodes again, or `dsl-assembly carry REVISION`"
