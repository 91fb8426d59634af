"""The report's pictures: that every series can be told from the others and is named."""

import re

import pytest

pytest.importorskip("matplotlib", reason="needs the extra `training`: pip install -e '.[training]'")

from training.report import plots

RATES = [plots.Rate(1.0, 0.5, 0.4, 0.6), plots.Rate(2.0, 0.8, 0.7, 0.9)]


def styles(svg: str) -> set[str]:
    """Colours and dashes of the lines."""
    return {
        f"{colour[1]} {dashes[1] if (dashes := re.search('stroke-dasharray: ([^;]+)', style)) else ''}"
        for style in re.findall(r'<path [^>]*style="([^"]+)"', svg)
        if (colour := re.search("stroke: (#[0-9a-f]{6})", style)) and colour[1] in plots.COLOURS
    }


def test_series_beyond_the_colours_are_dashed() -> None:
    for count in (len(plots.COLOURS), len(plots.COLOURS) + 2):
        svg = plots.success_by_clearance([(f"policy {i}", RATES) for i in range(count)], [], [])
        assert len(styles(svg)) == count
        assert all(f"policy {i}" in svg for i in range(count))


def test_a_series_that_only_a_later_panel_has_is_named_and_every_series_keeps_its_colour() -> None:
    first, second = ("c = 2 mm", [("one", [1.0, 2.0])]), ("c = 1 mm", [("other", [1.0, 2.0]), ("one", [2.0, 3.0])])
    svg = plots.peak_forces([first, second], 15.0)
    assert ">other<" in svg
    assert len(styles(svg)) == 2
