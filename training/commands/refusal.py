"""Refusals: a command ends with a message and a status other than zero."""

from typing import NoReturn

import typer

from wire.exits import Exit


def refuse(command: str, text: str, code: Exit = Exit.USAGE) -> NoReturn:
    """End the command with a status other than zero and the reason and remedy in `text`."""
    typer.echo(f"{command}: {text}", err=True)
    raise typer.Exit(code)


def refuse_without_extra(command: str, error: ImportError) -> NoReturn:
    """End the command because the extra `training` is not installed."""
    refuse(command, f"it needs the extra `training` ({error}): make setup-training")
