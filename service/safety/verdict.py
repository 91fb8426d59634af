"""The result of a check."""

from dataclasses import dataclass

from service.faults import FaultCode


@dataclass(frozen=True, slots=True)
class Verdict:
    """Result of a check.

    Attributes:
        fault: fault found; None when nothing is wrong.
        measured: value that was judged, in the unit of `limit`.
        limit: limit that the value was judged against.
        text: description of the fault, with its numbers; empty without a fault.
        accepted: False for a sample that is ignored (a duplicate, or older than the newest).
    """

    fault: FaultCode | None = None
    measured: float = 0.0
    limit: float = 0.0
    text: str = ""
    accepted: bool = True


PASSED = Verdict()
IGNORED = Verdict(accepted=False)
