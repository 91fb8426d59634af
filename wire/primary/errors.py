"""Errors in the bytes of the primary interface."""

from enum import StrEnum


class PrimaryErrorReason(StrEnum):
    """Kinds of `PrimaryError`."""

    FRAMING = "framing"
    """A size that no package has; the rest of the stream cannot be read."""
    MALFORMED = "malformed"
    """Content that does not fit its type."""


class PrimaryError(ValueError):
    """Bytes that are no primary package; `reason` gives the kind, the text says where and what."""

    def __init__(self, reason: PrimaryErrorReason, text: str) -> None:
        super().__init__(text)
        self.reason = reason
