from pathlib import Path
from xml.etree import ElementTree

from training.report.document import Document, Heading, Judged, Paragraph, Picture, Table

SVG = '<svg xmlns="http://www.w3.org/2000/svg"><path d="M 0 0"/></svg>'
DOCUMENT = Document(
    "A & B",
    [
        Paragraph("It is **bold**, `code<1>` and [there](there.md)."),
        Heading("First part"),
        Table(["a", "b"], [["1", Judged("met", "good")], ["2", "–"]], groups=frozenset({1}), folded="All 2 rows"),
        Heading("Smaller", 3),
        Picture("shape", SVG, "A shape"),
    ],
)


def body(html: str) -> ElementTree.Element:
    """The page's main part, which must be well-formed."""
    return ElementTree.fromstring(html[html.index("<main>") : html.index("</main>") + len("</main>")])  # noqa: S314


def test_the_page_holds_everything_and_fetches_nothing() -> None:
    page = DOCUMENT.to_html()
    assert SVG in page
    assert "src=" not in page
    assert "<link" not in page
    assert "@import" not in page


def test_the_page_is_well_formed_and_lists_its_parts() -> None:
    main = body(DOCUMENT.to_html())
    assert main.findtext("h1") == "A & B"
    links = main.findall("nav//a")
    assert [(link.text, link.get("href")) for link in links] == [("First part", "#first-part")]
    headings = main.findall("h2")
    assert [heading.get("id") for heading in headings] == ["first-part"]


def test_marks_are_set_and_other_text_is_not_taken_for_html() -> None:
    main = body(DOCUMENT.to_html())
    paragraph = main.find("p")
    assert paragraph is not None
    assert paragraph.findtext("strong") == "bold"
    assert paragraph.findtext("code") == "code<1>"
    link = paragraph.find("a")
    assert link is not None
    assert (link.text, link.get("href")) == ("there", "there.md")


def test_a_table_shows_its_verdicts_and_can_be_folded() -> None:
    details = body(DOCUMENT.to_html()).find("details")
    assert details is not None
    assert details.findtext("summary") == "All 2 rows"
    cells = [(cell.text, cell.get("class")) for cell in details.findall(".//td")]
    assert cells == [("1", None), ("met", "good"), ("2", None), ("–", None)]


def test_markdown_has_the_same_blocks_and_finds_the_pictures() -> None:
    text = DOCUMENT.to_markdown(Path("pictures/results"))
    assert text.splitlines()[0] == "# A & B"
    assert "| a | b |\n| --- | --- |\n| 1 | met |\n| 2 | – |" in text
    assert "![A shape](pictures/results/shape.svg)" in text
    assert "### Smaller" in text
