"""A group of commands that imports a command's module when the command is called, not before."""

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup


@dataclass(frozen=True, slots=True)
class Entry:
    """One command of a lazy group.

    Attributes:
        target: `module:name` of a function or of a `typer.Typer`.
        help: how its own help begins.
        panel: heading that it is listed under.
    """

    target: str
    help: str
    panel: str


class LazyGroup(TyperGroup):
    """Lists `entries` from what they say, and loads the one that is called."""

    entries: ClassVar[Mapping[str, Entry]] = {}

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        for name, entry in self.entries.items():
            self.add_command(TyperCommand(name, help=entry.help, rich_help_panel=entry.panel))

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that is called, and load it in place of its stand-in."""
        name, command, rest = super().resolve_command(ctx, args)
        return name, load(self.entries[name], name) if name is not None else command, rest


def load(entry: Entry, name: str) -> Any:
    """Import an entry's target and return it as a command or a group of that name."""
    module, _, attribute = entry.target.partition(":")
    target = getattr(importlib.import_module(module), attribute)
    if not isinstance(target, typer.Typer):
        alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        alone.command(name)(target)
        target = alone
    command = typer.main.get_command(target)
    command.name = name
    return command
