"""How a command ends with a reason."""

import os
import sys
from typing import NoReturn

import typer

from wire.exits import Exit


def fail(command: str, text: str, code: Exit) -> NoReturn:
    """End the command; `text` says what is wrong and what to do."""
    typer.echo(f"{command}: {text}", err=True)
    raise typer.Exit(int(code))


def leave(code: int) -> NoReturn:
    """End the process at once: a session that is still open would hold the interpreter's own end up for seconds."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
