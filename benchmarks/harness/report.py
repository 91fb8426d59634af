"""Reports of results: a table for people and JSON for programs."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.harness.result import Figure, Result

_LIMIT_COLUMNS = ("figure", "measured", "limit", "holds")


def show(console: Console, name: str, result: Result) -> None:
    if result.missing:
        console.print(f"[bold]{name}[/bold]: not measured: {result.missing}\n", highlight=False)
        return
    table = Table(*result.columns, title=result.question, title_justify="left", caption=result.finding)
    for column in table.columns[1:]:
        column.justify = "right"
    for row in result.rows:
        table.add_row(*row)
    console.print(table, highlight=False)
    if result.figures:
        limits = Table(*_LIMIT_COLUMNS)
        for row in _limits(result.figures):
            limits.add_row(*row)
        console.print(limits, highlight=False)
    console.print()


def save(folder: Path, conditions: Mapping[str, str], results: Mapping[str, Result]) -> tuple[Path, Path]:
    """Write `latest.md` and `latest.json`; return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    markdown, document = folder / "latest.md", folder / "latest.json"
    markdown.write_text(_markdown(conditions, results), "utf-8")
    plain = {"conditions": dict(conditions), "results": {name: asdict(result) for name, result in results.items()}}
    document.write_text(json.dumps(plain, indent=1, ensure_ascii=False) + "\n", "utf-8")
    return markdown, document


def _markdown(conditions: Mapping[str, str], results: Mapping[str, Result]) -> str:
    lines = ["# Benchmarks, latest run", "", "Guide: [benchmarks.md](../../docs/reference/benchmarks.md).", ""]
    lines += [*_table(("condition", "value"), tuple(conditions.items())), ""]
    for name, result in results.items():
        lines += [f"## {name}", "", result.question, ""]
        if result.missing:
            lines += [f"Not measured: {result.missing}", ""]
            continue
        lines += [*_table(result.columns, result.rows), ""]
        if result.figures:
            lines += [*_table(_LIMIT_COLUMNS, _limits(result.figures)), ""]
        lines += [text for paragraph in (result.finding, result.method) if paragraph for text in (paragraph, "")]
    return "\n".join(lines)


def _limits(figures: tuple[Figure, ...]) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (
            figure.name,
            f"{figure.value:.3g} {figure.unit}",
            f"{'at least' if figure.at_least else 'at most'} {figure.limit:g}",
            "yes" if figure.holds else "NO",
        )
        for figure in figures
    )


def _table(columns: tuple[str, ...], rows: tuple[tuple[str, ...], ...]) -> list[str]:
    rule = "|" + "---|" + "---:|" * (len(columns) - 1)
    return [f"| {' | '.join(columns)} |", rule, *(f"| {' | '.join(row)} |" for row in rows)]
