"""Command line of training: `dsl-assembly`, or `python -m training`."""

import typer

from training.commands.baseline import baseline
from training.commands.carry import carry
from training.commands.evaluate import evaluate
from training.commands.export import export
from training.commands.gallery import gallery
from training.commands.report import report
from training.commands.reproduce import reproduce
from training.commands.train import train

app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False)
for command in (train, export, evaluate, report, reproduce, carry, baseline, gallery):
    app.command()(command)

if __name__ == "__main__":
    app()
