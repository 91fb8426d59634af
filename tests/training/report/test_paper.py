"""The report's figures of the paper against the paper's own source."""

import pytest

from sim_backend.world.parts import PARTS, proportion
from training.learning import experiment
from training.report import paper
from training.report.paper import TablePlan

COMPARISON = paper.comparison()


def test_every_cell_of_table_2_is_measured_at_the_clearance_that_has_its_proportion() -> None:
    cells = COMPARISON.table_2.cells
    assert len(cells) == 9
    for cell in cells:
        ours = float(proportion(PARTS[cell.part], paper.metres(cell.clearance_mm)))
        assert ours == pytest.approx(cell.proportion, abs=6e-4)


def test_each_count_gives_a_figure_that_the_paper_prints() -> None:
    for cell in COMPARISON.table_2.cells:
        successes, tests = cell.count
        assert 40 <= tests <= 60
        assert min(abs(successes / tests - printed) for printed in (cell.printed, cell.text or 0)) < 1.5e-4


def test_a_cell_is_beaten_only_above_the_larger_of_table_and_text() -> None:
    larger = {(cell.part, cell.proportion): cell.larger for cell in COMPARISON.table_2.cells}
    assert larger["tr", 0.078] == 0.2864
    assert larger["trm", 0.0933] == 0.2543
    assert larger["b-trm", 0.205] == 0.4137
    assert larger["cir", 0.1378] == 0.2


def test_every_row_of_table_1_and_every_learning_curve_belongs_to_an_experiment() -> None:
    known = set(experiment.names())
    levels = [level for gap in COMPARISON.table_1.gaps for level in gap.clearance_mm]
    assert {row.reproduction(level) for row in COMPARISON.table_1.rows for level in levels} <= known
    assert {row.ours for row in COMPARISON.table_1.rows} <= known
    assert {run.experiment for figure in COMPARISON.curves for run in figure.runs} <= known


@pytest.mark.parametrize("plan", list(TablePlan))
def test_a_plan_measures_the_policy_without_a_camera_in_a_search_domain(plan: TablePlan) -> None:
    conditions = {drawn for _, _, drawn in paper.cells_of(plan, "FTM")}
    assert conditions == {"transfer" if plan is TablePlan.TABLE_2 else "search"}
    assert (
        len(set(paper.cells_of(plan, "VFTM")))
        == {TablePlan.STRENGTH: 6, TablePlan.TABLE_1: 4, TablePlan.TABLE_2: 9}[plan]
    )


def test_what_is_reported_of_a_policy_is_what_the_tables_name_it_for() -> None:
    shipped = paper.reported("vftm-dsl", "VFTM")
    assert set(shipped) >= {(*cell, None) for plan in TablePlan for cell in paper.cells_of(plan, "VFTM")}
    assert ("tr", 1.33e-3, "standard", "off") in shipped
    assert ("tr", 0.33e-3, COMPARISON.strength.hardened, None) in shipped
    for name in ("vftm-dsl", "vftm-dsl-shapes"):
        played = {part for part, _, conditions, _ in paper.reported(name, "VFTM") if conditions == "standard"}
        assert played == {"tr", "rtr", "trm", "cir", "b-rtr", "b-trm"}
    assert paper.reported("paper-vftm-c133", "VFTM") == [("tr", 1.33e-3, "standard", None)]
    assert paper.reported("paper-ftm-c400", "FTM") == [("tr", 4e-3, "search", None)]
    assert paper.reported("somebody-elses", "VFTM") == []
