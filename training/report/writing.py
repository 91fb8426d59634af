"""The report as a whole: its chapters in order, and its files."""

from pathlib import Path

from training import files
from training.report import findings, paper, record
from training.report import own_chapters as own
from training.report import paper_chapters as others
from training.report.document import Document
from training.report.measured import Measured

TITLE = "Results"
PICTURES = "results"


def document(measured: Measured) -> Document:
    """Return the report of everything that was measured: findings first, digests last."""
    comparison = paper.comparison()
    return Document(
        TITLE,
        [
            *findings.found(measured, comparison),
            *findings.conditions(),
            *own.strength(measured, comparison),
            *others.table_1(measured, comparison),
            *others.learning_curves(measured, comparison),
            *others.table_2(measured, comparison),
            *own.force(measured, comparison),
            *own.service(measured),
            *others.contradictions(comparison),
            *record.record(measured),
        ],
    )


def write(report: Document, folder: Path) -> list[Path]:
    """Write `results.html`, `results.md` and the pictures of the latter, and remove pictures of an earlier report.

    Returns:
        The files that were written.
    """
    pictures = folder / "pictures" / PICTURES
    texts = {
        folder / "results.html": report.to_html(),
        folder / "results.md": report.to_markdown(pictures.relative_to(folder)),
        **{pictures / f"{picture.name}.svg": picture.svg for picture in report.pictures},
    }
    for path, text in texts.items():
        files.write(path, text.encode())
    for path in set(pictures.glob("*.svg")) - texts.keys():
        path.unlink()
    return list(texts)
