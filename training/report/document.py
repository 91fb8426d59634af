"""A document of headings, paragraphs, tables and pictures, as one HTML page and as Markdown.

Its text is Markdown limited to `**bold**`, `` `code` `` and `[text](address)`.
"""

import html
import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Literal

Judgement = Literal["good", "bad"]
_FIRST = ' class="first"'
PROSE = 60
"""Characters from which a cell's text may take several lines."""
_MARKS = (
    (re.compile(r"\*\*(.+?)\*\*"), r"<strong>\1</strong>"),
    (re.compile(r"`(.+?)`"), r"<code>\1</code>"),
    (re.compile(r"\[(.+?)\]\((.+?)\)"), r'<a href="\2">\1</a>'),
)


@dataclass(frozen=True, slots=True)
class Heading:
    """A heading of level 2 or 3; the title of the document has level 1."""

    text: str
    level: Literal[2, 3] = 2


@dataclass(frozen=True, slots=True)
class Paragraph:
    text: str


@dataclass(frozen=True, slots=True)
class Judged:
    """Text of a cell that is shown as good or bad."""

    text: str
    verdict: Judgement


@dataclass(frozen=True, slots=True)
class Table:
    """Columns and rows.

    Attributes:
        header: titles of the columns.
        rows: rows with a cell per column.
        groups: rows, counted from 0, above which the page draws a line.
        folded: summary under which the page hides the table; empty: the table shows.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str | Judged]]
    groups: frozenset[int] = frozenset()
    folded: str = ""


@dataclass(frozen=True, slots=True)
class Picture:
    """An SVG with a caption.

    Attributes:
        name: name of its file without the ending.
        svg: text of the SVG.
        caption: description, also for readers who do not see the picture.
    """

    name: str
    svg: str
    caption: str


ReportBlock = Heading | Paragraph | Table | Picture


@dataclass(frozen=True, slots=True)
class Document:
    title: str
    blocks: Sequence[ReportBlock]

    @property
    def pictures(self) -> list[Picture]:
        return [block for block in self.blocks if isinstance(block, Picture)]

    def to_html(self) -> str:
        """Return one page with everything in it."""
        page = Template((files("training.report") / "page.html").read_text())
        contents = "".join(
            f'<li><a href="#{_anchor(block.text)}">{_rich(block.text)}</a></li>'
            for block in self.blocks
            if isinstance(block, Heading) and block.level == 2
        )
        body = "\n".join(_html(block) for block in self.blocks)
        return page.substitute(title=html.escape(self.title), contents=contents, body=body)

    def to_markdown(self, pictures: Path) -> str:
        """Return Markdown that finds the pictures, as SVG files, in the folder `pictures` relative to the page."""
        parts = [f"# {self.title}", *(_markdown(block, pictures) for block in self.blocks)]
        return "\n\n".join(parts) + "\n"


def _html(block: ReportBlock) -> str:
    match block:
        case Heading(text, level):
            return f'<h{level} id="{_anchor(text)}">{_rich(text)}</h{level}>'
        case Paragraph(text):
            return f"<p>{_rich(text)}</p>"
        case Picture(_, svg, caption):
            label, shown = html.escape(caption), _rich(caption)
            return f'<figure role="img" aria-label="{label}">{svg}<figcaption>{shown}</figcaption></figure>'
        case Table(header, rows, groups, folded):
            head = "".join(f"<th>{_rich(text)}</th>" for text in header)
            lines = "\n".join(
                f"<tr{_FIRST if number in groups else ''}>{''.join(map(_cell, row))}</tr>"
                for number, row in enumerate(rows)
            )
            table = f'<div class="table"><table><thead><tr>{head}</tr></thead><tbody>\n{lines}\n</tbody></table></div>'
            return f"<details><summary>{_rich(folded)}</summary>{table}</details>" if folded else table


def _cell(cell: str | Judged) -> str:
    if isinstance(cell, Judged):
        return f'<td class="{cell.verdict}">{_rich(cell.text)}</td>'
    return f'<td class="prose">{_rich(cell)}</td>' if len(cell) > PROSE else f"<td>{_rich(cell)}</td>"


def _markdown(block: ReportBlock, pictures: Path) -> str:
    match block:
        case Heading(text, level):
            return f"{'#' * level} {text}"
        case Paragraph(text):
            return text
        case Picture(name, _, caption):
            return f"![{caption}]({(pictures / name).as_posix()}.svg)"
        case Table(header, rows):
            lines = [header, ["---"] * len(header), *rows]
            return "\n".join(
                "| " + " | ".join(cell.text if isinstance(cell, Judged) else cell for cell in line) + " |"
                for line in lines
            )


def _rich(text: str) -> str:
    rich = html.escape(text, quote=False)
    for pattern, by in _MARKS:
        rich = pattern.sub(by, rich)
    return rich


def _anchor(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")
