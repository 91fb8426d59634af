"""How a command ends with a reason."""

from typing import NoReturn

import typer

from wire.exits import Exit


def fail(command: str, text: str, code: Exit) -> NoReturn:
    """End the command; `text` says what is wrong and what to do."""
    typer.echo(f"{command}: {text}", err=True)
    raise typer.Exit(int(code))
