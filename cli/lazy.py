"""A group of commands that imports a command's module when the command is run or asked for its help, not before."""

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
        help: the first sentence of its own help.
        panel: heading that it is listed under.
    """

    target: str
    help: str
    panel: str

    def load(self) -> Any:
        """Import the function or the `typer.Typer`."""
        module, _, name = self.target.partition(":")
        return getattr(importlib.import_module(module), name)


class LazyGroup(TyperGroup):
    """Lists `entries` from what they say here, and loads the one that is called."""

    entries: ClassVar[Mapping[str, Entry]] = {}

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names in the order of the table."""
        return list(self.entries)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a stand-in that can be listed; `resolve_command` loads the real one."""
        entry = self.entries.get(cmd_name)
        return entry and TyperCommand(cmd_name, help=entry.help, rich_help_panel=entry.panel)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that is called, and load it."""
        name, command, rest = super().resolve_command(ctx, args)
        return name, command and load(self.entries[command.name or ""], command.name or ""), rest


def load(entry: Entry, name: str) -> Any:
    """Import an entry's target and return it as a command or a group of that name."""
    target = entry.load()
    if not isinstance(target, typer.Typer):
        alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        alone.command(name)(target)
        target = alone
    command = typer.main.get_command(target)
    command.name = name
    return command
