"""The answer of a check."""

from dataclasses import dataclass

from service.faults import FaultCode


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a check found.

    Attributes:
        fault: None when nothing is wrong.
        measured: the value that was judged, in the unit of `limit`.
        limit: what it was judged against.
        text: what is wrong, with the numbers; empty when nothing is.
        accepted: False for a sample that is ignored (a duplicate, or older than the newest).
    """

    fault: FaultCode | None = None
    measured: float = 0.0
    limit: float = 0.0
    text: str = ""
    accepted: bool = True


PASSED = Verdict()
IGNORED = Verdict(accepted=False)
