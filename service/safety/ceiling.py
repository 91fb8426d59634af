"""The ceilings on the measured force and torque: one judgement for the monitor and for the judge at the transport."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, inf, isfinite

from service.faults import FaultCode
from service.safety.verdict import PASSED, Verdict

PLAUSIBLE = 1e6
"""Largest plausible magnitude, in N, N·m, m, rad and their rates. No cell measures more, and squares may overflow."""


def is_plausible(channels: Sequence[float]) -> bool:
    """Return whether all numbers are finite and at most `PLAUSIBLE` in magnitude."""
    # A sum is finite only if every term is finite; `max` has a meaning only then
    return isfinite(sum(channels)) and max(map(abs, channels)) <= PLAUSIBLE


@dataclass(frozen=True, slots=True)
class Ceiling:
    """Limits on one wrench. It keeps nothing between two samples, so any thread may judge by it.

    Attributes:
        force_n: resultant force that trips, N.
        torque_nm: resultant torque at the TCP that trips, N·m.
        force_range_n: force component at the end of the sensor's range, N; it trips as well.
        torque_range_nm: torque component at the end of the sensor's range, N·m; it trips as well.
    """

    force_n: float
    torque_nm: float
    force_range_n: float = inf
    torque_range_nm: float = inf

    def judge(self, channels: Sequence[float], *, saturated: bool) -> Verdict:
        """Judge a plausible wrench.

        Args:
            channels: six forces and torques at the TCP, N and N·m.
            saturated: True if a raw channel is at the end of the sensor's range.

        Returns:
            `PASSED`, or FORCE_CEILING.
        """
        fx, fy, fz, tx, ty, tz = channels
        force, torque = hypot(fx, fy, fz), hypot(tx, ty, tz)
        if force >= self.force_n:
            text = f"force {force:.2f} N, ceiling {self.force_n:g} N"
            return Verdict(FaultCode.FORCE_CEILING, force, self.force_n, text)
        if torque >= self.torque_nm:
            text = f"torque {torque:.3f} N·m, ceiling {self.torque_nm:g} N·m"
            return Verdict(FaultCode.FORCE_CEILING, torque, self.torque_nm, text)
        if (
            saturated
            or max(abs(fx), abs(fy), abs(fz)) >= self.force_range_n
            or max(abs(tx), abs(ty), abs(tz)) >= self.torque_range_nm
        ):
            return Verdict(
                FaultCode.FORCE_CEILING,
                force,
                self.force_n,
                f"sensor at the end of its range reads {force:.2f} N and {torque:.3f} N·m: "
                "the true load is unknown and counts as above the ceiling",
            )
        return PASSED
