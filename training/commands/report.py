"""`report`: write the results beside the paper as HTML and Markdown, and a card for every model."""

from pathlib import Path
from typing import Annotated

import typer

from service.policy.model import PolicyError
from training.commands.refusal import refuse, refuse_without_extra
from training.evaluation import panel
from training.evaluation.results import RESULTS, ResultsError


def report(
    results: Annotated[Path, typer.Option(help="Folder of the results.")] = RESULTS,
    runs: Annotated[
        Path, typer.Option(help="Folder of trainings; their learning curves are kept beside the results.")
    ] = Path("var/training"),
    out: Annotated[
        Path, typer.Option(help="Folder for results.html, results.md, models.md, panels.md and pictures/results/.")
    ] = Path("docs"),
    models: Annotated[
        Path, typer.Option(help="Folder of the policies; without policies no models.md is written.")
    ] = Path("models"),
) -> None:
    """Write the report of all results and the models' cards. Nothing is played."""
    try:
        from training.report import cards, curves, panels, writing
        from training.report.measured import Measured
    except ImportError as error:
        refuse_without_extra("report", error)
    try:
        kept = curves.collect(runs, results)
        measured = Measured.read(results)
        shipped = cards.read(models, measured)
        on_panels = panel.read(results)
        files = writing.write(writing.document(measured), out)
    except (ResultsError, PolicyError) as error:
        refuse("report", str(error))
    typer.echo(f"{len(measured.results)} policies, {len(measured.curves)} trainings ({kept} of them new or longer)")
    typer.echo(f"wrote {files[0]}, {files[1]} and {len(files) - 2} pictures")
    if shipped:
        typer.echo(f"wrote {cards.write(shipped, out)}: cards of {len(shipped)} models")
    else:
        typer.echo(f"no policies in {models}: no {cards.PAGE}")
    if on_panels:
        typer.echo(f"wrote {panels.write(on_panels, out)}: {sum(map(len, on_panels.values()))} results on panels")
