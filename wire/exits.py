"""Exit statuses of the commands: one table for every package that has commands."""

from enum import IntEnum


class Exit(IntEnum):
    """Exit statuses other than 0; `docs/reference/command.md` lists them for people."""

    FAILED = 1
    """Carried out, but without the wanted outcome: the peg is not in, a check did not pass, results differ."""
    USAGE = 2
    """A wrong option, or a configuration or a file that cannot be used."""
    HOST = 3
    """The machine refuses: a port or an endpoint in use, a folder that cannot be written, no rendering."""
    UNREACHABLE = 4
    """Nobody answered: no API there, or no control process behind it."""
    REFUSED = 5
    """The cell answered, and refused."""
    UNCONFIRMED = 6
    """A stop was delivered, but standstill is not measured yet."""
    INTERRUPTED = 130
    """Ctrl-C."""
