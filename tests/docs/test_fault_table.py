"""Every fault of the table has a test by its number, and the document says which."""

import pytest

from tests import fault_table


@pytest.mark.parametrize("row", fault_table.rows(), ids=lambda row: str(row.number))
def test_the_row_has_a_test_or_a_reason(row: fault_table.Row) -> None:
    tests = fault_table.tests_by_row()[row.number]
    assert bool(tests) != bool(row.untested), f"name a test test_{row.number:02d}_..., or give a reason"


def test_no_test_has_the_number_of_no_row() -> None:
    assert set(fault_table.tests_by_row()) <= {row.number for row in fault_table.rows()}


def test_the_document_is_up_to_date() -> None:
    assert fault_table.DOCUMENT.read_text() == fault_table.text(), "run python -m tests.fault_table"
