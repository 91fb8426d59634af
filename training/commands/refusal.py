"""How a command says that it cannot do what it was asked."""

from typing import NoReturn

import typer

EXIT_USAGE = 2


def refuse(command: str, text: str, code: int = EXIT_USAGE) -> NoReturn:
    """End the command with a status other than zero; `text` says what is wrong and what to do."""
    typer.echo(f"{command}: {text}", err=True)
    raise typer.Exit(code)


def refuse_without_extra(command: str, error: ImportError) -> NoReturn:
    """The same where what only training needs is not installed."""
    refuse(command, f"it needs the extra `training` ({error}): make setup-training")
