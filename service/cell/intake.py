"""The intake of samples: every one is judged, the newest believed one is kept, and the others are counted."""

from collections.abc import Callable

import numpy as np

from service.cell.lateness import Lateness
from service.cell.plan import plan_monitor
from service.config import LimitsSection
from service.drivers.base import Load, Program, Sample
from service.faults import FaultCode
from service.messages import Counters
from service.safety.ceiling import is_plausible
from service.safety.monitor import Monitor
from service.safety.verdict import PASSED, Verdict

UNBELIEVED = frozenset({FaultCode.SENSOR_INVALID, FaultCode.SOURCE, FaultCode.LINK})
"""Faults that make the sample itself unusable."""
FIRST_SAMPLE_S = 2.0
"""Time in which the first sample must come after connecting."""


class Intake:
    """Judges the samples of one arm.

    Args:
        limits: of the cell.
        clock: the driver's clock, which stamps arrivals.

    Attributes:
        sample: the newest believed one since `renew`.
        accepted: samples believed so far.
        force_ceiling_n: in force.
    """

    def __init__(self, limits: LimitsSection, clock: Callable[[], float]) -> None:
        self._limits = limits
        self._clock = clock
        self._parameters = plan_monitor(limits, limits.force_ceiling_n)
        self._monitor, self._ceiling = Monitor(self._parameters), self._parameters.ceiling
        self._renewed_at = 0.0
        self._recent_peak_n = 0.0
        self._ignored = self._missed = 0
        self.sample: Sample | None = None
        self.accepted = 0
        self.force_ceiling_n = limits.force_ceiling_n

    def judge(self, sample: Sample) -> Verdict:
        """Judge a sample on its arrival; keep it if it is believed."""
        verdict = _check(self._monitor, sample)
        if not verdict.accepted:
            self._ignored += 1
        elif verdict.fault not in UNBELIEVED:
            self.accepted += 1
            self._recent_peak_n = max(self._recent_peak_n, self._monitor.force_n)
            if self.sample is not None:
                self._missed += max(0, sample.seq - self.sample.seq - 1)
            self.sample = sample
        return verdict

    def judge_alone(self, sample: Sample) -> Verdict:
        """Judge a sample without regard to earlier ones; keep nothing of it."""
        return _check(Monitor(self._parameters), sample)

    def judge_ceiling(self, load: Load) -> Verdict:
        """Judge a load by the ceilings in force alone. It changes nothing and may be called on any thread.

        Args:
            load: one that is not plausible passes, as does one of another source: the monitor has other faults for
                them.
        """
        newest = self.sample
        if (newest is not None and load.epoch != newest.epoch) or not is_plausible(load.wrench):
            return PASSED
        return self._ceiling.judge(load.wrench, saturated=load.saturated)

    def renew(self, force_ceiling_n: float | None = None) -> None:
        """Expect another source or another world: the next sample is the first.

        Args:
            force_ceiling_n: of a run; None: that of the cell.
        """
        self.force_ceiling_n = self._limits.force_ceiling_n if force_ceiling_n is None else force_ceiling_n
        self._parameters = plan_monitor(self._limits, self.force_ceiling_n)
        self._monitor, self._ceiling = Monitor(self._parameters), self._parameters.ceiling
        self._renewed_at = self._clock()
        self.sample = None

    def overdue(self) -> Verdict:
        """Judge whether samples are overdue; a source just connected has `FIRST_SAMPLE_S` for its first one."""
        patience_s = FIRST_SAMPLE_S if self.sample is None else self._limits.sample_age_s
        now = self._clock()
        return PASSED if now - self._renewed_at < patience_s else self._monitor.overdue(now)

    def clear_peak(self) -> None:
        """Begin a new peak; a run starts."""
        self._monitor.clear_peak()

    def take_recent_peak(self) -> float:
        """Return the largest force of any believed sample since the last call, N."""
        peak_n, self._recent_peak_n = self._recent_peak_n, 0.0
        return peak_n

    @property
    def peak_force_n(self) -> float:
        return self._monitor.peak_force_n

    @property
    def force_n(self) -> float:
        return self._monitor.force_n

    @property
    def age_s(self) -> float:
        """Age of the newest believed sample; infinite without one."""
        return float("inf") if self.sample is None else self._clock() - self.sample.arrival_s

    @property
    def is_fresh(self) -> bool:
        return self.age_s < self._limits.sample_age_s

    @property
    def time_s(self) -> float:
        """Time of the newest sample on the arm's clock; 0 without one."""
        return 0.0 if self.sample is None else self.sample.time_s

    @property
    def in_protective_stop(self) -> bool:
        return self.sample is not None and self.sample.program is Program.PROTECTIVE_STOP

    def counters(self, samples_dropped: int, telemetry_dropped: int, lateness: Lateness) -> Counters:
        """Return the counts of samples, together with counts made elsewhere."""
        return Counters(
            samples=self.accepted,
            samples_ignored=self._ignored,
            samples_missed=self._missed,
            samples_dropped=samples_dropped,
            telemetry_dropped=telemetry_dropped,
            loop_overruns=lateness.overruns,
            loop_late_p99_s=lateness.p99_s,
            loop_late_max_s=lateness.max_s,
        )


def _check(monitor: Monitor, sample: Sample) -> Verdict:
    return monitor.check(
        epoch=sample.epoch,
        episode=sample.episode,
        seq=sample.seq,
        time_s=sample.time_s,
        wrench=sample.wrench,
        raw=sample.ft_raw,
        motion=np.concatenate((sample.q, sample.qd, sample.tcp_position, sample.tcp_rotvec, sample.tcp_velocity)),
        saturated=sample.saturated,
        now=sample.arrival_s,
    )
