"""Errors of an RTDE connection: one root, a reason that code can match on, a text that says what to do."""

from collections.abc import Mapping
from enum import StrEnum


class RtdeErrorReason(StrEnum):
    """Kinds of `RtdeError`."""

    FRAMING = "framing"
    """The bytes cannot be cut into packages: they contain a length that no package has."""
    MALFORMED = "malformed"
    """The content of a package does not fit its type."""
    UNKNOWN_PACKAGE = "unknown_package"
    """RTDE has no such package type, or not in this direction."""
    WRONG_RECIPE = "wrong_recipe"
    """A data package follows a recipe that was not agreed."""
    WRONG_VALUE = "wrong_value"
    """A value does not fit its variable."""
    UNEXPECTED = "unexpected"
    """A reply came that nobody asked for."""
    NOT_FOUND = "NOT_FOUND"
    """The controller does not know a variable."""
    IN_USE = "IN_USE"
    """Another client or a field bus holds the variable."""
    REFUSED = "refused"
    """The controller refused."""
    TIMEOUT = "timeout"
    UNREACHABLE = "unreachable"
    CLOSED = "closed"
    """The connection ended."""


class RtdeError(Exception):
    """Root of all RTDE errors; `reason` gives the kind, the text says what happened and what to do."""

    def __init__(self, reason: RtdeErrorReason, text: str) -> None:
        super().__init__(text)
        self.reason = reason


class FramingError(RtdeError):
    """The stream is out of step and cannot recover: close the connection."""

    def __init__(self, text: str) -> None:
        super().__init__(RtdeErrorReason.FRAMING, text)


class PackageError(RtdeError):
    """One package violates its type, its recipe or the agreed recipes."""


class SetupError(RtdeError):
    """The controller refused variables of a recipe.

    Attributes:
        refused: reason for each refused variable, `RtdeErrorReason.NOT_FOUND` or `RtdeErrorReason.IN_USE`.
    """

    def __init__(self, refused: Mapping[str, RtdeErrorReason]) -> None:
        held = [name for name, reason in refused.items() if reason is RtdeErrorReason.IN_USE]
        unknown = [name for name, reason in refused.items() if reason is RtdeErrorReason.NOT_FOUND]
        parts: list[str] = []
        if held:
            parts.append(
                f"in use by another client or a field bus: {', '.join(held)}; end or disconnect it, a control process "
                "that still runs included"
            )
        if unknown:
            parts.append(f"not known to the controller: {', '.join(unknown)}; check the spelling and its version")
        super().__init__(RtdeErrorReason.IN_USE if held else RtdeErrorReason.NOT_FOUND, "; ".join(parts))
        self.refused = dict(refused)
