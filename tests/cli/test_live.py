import io

from rich.console import Console

from cli.live import View


def shown(status: dict[str, object]) -> str:
    console = Console(file=io.StringIO(), width=120)
    view = View(console)
    view.status, view.frame = status, {"force_peak_n": 4.2}
    console.print(view.render())
    return console.file.getvalue()  # type: ignore[attr-defined]


def test_the_force_stands_beside_the_ceiling_in_force() -> None:
    assert "4.2 N of 20" in shown({"state": "RUNNING", "force_ceiling_n": 20.0})


def test_a_ceiling_that_is_not_known_is_not_shown() -> None:
    text = shown({"state": "UNKNOWN", "force_ceiling_n": None})
    assert "4.2 N" in text
    assert "the ceiling in force is not known" in text
    assert " of " not in text
