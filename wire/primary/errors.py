"""What can be wrong with bytes of the primary interface."""

from enum import StrEnum


class PrimaryErrorReason(StrEnum):
    """Why bytes are no primary package."""

    FRAMING = "framing"
    """A size that no package has; the stream cannot be followed any further."""
    MALFORMED = "malformed"
    """A content that does not fit its type."""


class PrimaryError(ValueError):
    """Bytes that are no primary package; `reason` says which kind, the text where and what."""

    def __init__(self, reason: PrimaryErrorReason, text: str) -> None:
        super().__init__(text)
        self.reason = reason
