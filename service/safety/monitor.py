"""Judges every sensor sample of one cell at 500 Hz, independently of the policy, the run and everything slower.

It uses plain floats and `math`: on six numbers numpy's call overhead would dominate.
"""

from dataclasses import dataclass, fields
from math import hypot, inf, isfinite, nan

from service.faults import FaultCode
from service.safety.ceiling import Ceiling, is_plausible
from service.safety.verdict import IGNORED, PASSED, Verdict
from wire.arrays import FloatArray
from wire.limits import FORCE_HARD_MAXIMUM_N, TORQUE_HARD_MAXIMUM_NM

_CHANNELS = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
STANDING_STAMPS = 3
"""Consecutive stamps without advance that mean a stopped clock. A clock that was set back gives a single one."""


@dataclass(frozen=True, slots=True)
class MonitorParameters:
    """Limits on a sample; the configuration sets the values.

    Attributes:
        force_ceiling_n: resultant force that trips, N.
        torque_ceiling_nm: resultant torque at the TCP that trips, N·m.
        stuck_samples: number of consecutive samples, bit-identical in all forces or in all torques, that mean a stuck
            sensor.
        stuck_channel_samples: number of consecutive samples, bit-identical in one channel, that mean a stuck channel. A
            quantised sensor repeats itself honestly: with noise as large as its resolution, 25 in a row have a chance
            of 1e-10.
        max_age_s: age of the newest sample from which the cell counts as blind, s.
        max_gap_s: largest forward step between the time stamps of two consecutive samples, s.
        force_range_n: force component at the end of the sensor's range, N; it trips as well. Infinite if the source
            itself reports saturation.
        torque_range_nm: torque component at the end of the sensor's range, N·m; otherwise as `force_range_n`.
    """

    force_ceiling_n: float
    torque_ceiling_nm: float
    stuck_samples: int
    stuck_channel_samples: int
    max_age_s: float
    max_gap_s: float
    force_range_n: float = inf
    torque_range_nm: float = inf

    def __post_init__(self) -> None:
        """Refuse limits that guard nothing.

        Raises:
            ValueError: a field is out of range; the text names it.
        """
        for field in fields(self):
            value = getattr(self, field.name)
            if not value > 0 or (value == inf and not field.name.endswith(("range_n", "range_nm"))):
                raise ValueError(f"monitor.{field.name} must be finite and above zero, not {value!r}")
        if self.force_ceiling_n > FORCE_HARD_MAXIMUM_N:
            raise ValueError(
                f"monitor.force_ceiling_n is {self.force_ceiling_n:g} N, "
                f"above the hard maximum of {FORCE_HARD_MAXIMUM_N:g} N"
            )
        if self.torque_ceiling_nm > TORQUE_HARD_MAXIMUM_NM:
            raise ValueError(
                f"monitor.torque_ceiling_nm is {self.torque_ceiling_nm:g} N·m, "
                f"above the hard maximum of {TORQUE_HARD_MAXIMUM_NM:g} N·m"
            )
        if self.stuck_samples < 2:
            raise ValueError("monitor.stuck_samples must be 2 or more: one sample cannot repeat itself")
        if self.stuck_channel_samples < self.stuck_samples:
            raise ValueError(
                f"monitor.stuck_channel_samples is {self.stuck_channel_samples}, below monitor.stuck_samples "
                f"({self.stuck_samples}): one channel repeats itself more easily than all"
            )

    @property
    def ceiling(self) -> Ceiling:
        """Ceilings among these limits."""
        return Ceiling(self.force_ceiling_n, self.torque_ceiling_nm, self.force_range_n, self.torque_range_nm)


class Repeats:
    """Counts the consecutive samples in which a channel of a wrench has not changed by a bit."""

    __slots__ = ("_last", "_since")

    def __init__(self) -> None:
        self._last: list[float] = [nan] * 6
        self._since = [1] * 6

    def stuck(self, channels: list[float], samples: int, channel_samples: int) -> tuple[str, int, int] | None:
        """Take in one sample.

        Args:
            channels: the six channels, N and N·m.
            samples: limit for all forces, or all torques.
            channel_samples: limit for one channel.

        Returns:
            What is stuck, since how many samples, and their limit; None if nothing is.
        """
        if not any(map(float.__eq__, channels, self._last)):  # as nearly always; every limit is 2 or more
            self._last, self._since = channels, [1] * 6
            return None
        since = self._since = [
            count + 1 if now == before else 1
            for count, now, before in zip(self._since, channels, self._last, strict=True)
        ]
        self._last = channels
        for name, count in (("force", min(since[:3])), ("torque", min(since[3:]))):
            if count >= samples:
                return f"every channel of {name}", count, samples
        longest = max(since)
        if longest >= channel_samples:
            return f"channel {_CHANNELS[since.index(longest)]}", longest, channel_samples
        return None


class Monitor:
    """Judges one cell's samples; not shared between cells or threads.

    It judges each sample on its own and latches nothing. The caller must latch the first fault.
    """

    __slots__ = (
        "_arrival",
        "_ceiling",
        "_episode",
        "_epoch",
        "_force",
        "_parameters",
        "_peak",
        "_raw_repeats",
        "_repeats",
        "_seq",
        "_standing",
        "_time",
    )

    def __init__(self, parameters: MonitorParameters) -> None:
        self._parameters = parameters
        self._ceiling = parameters.ceiling
        self.reset()

    def reset(self) -> None:
        """Forget source, sequence and peak, for a new connection or a new episode. The next sample is the first."""
        self._epoch: int | None = None
        self._episode = 0
        self._seq = -1
        self._time: float | None = None
        self._arrival = -inf
        self._repeats, self._raw_repeats = Repeats(), Repeats()
        self._standing = 0
        self._force = 0.0
        self._peak = 0.0

    @property
    def force_n(self) -> float:
        """Resultant force of the newest finite sample, N."""
        return self._force

    @property
    def peak_force_n(self) -> float:
        """Largest resultant force of any finite sample since `reset` or `clear_peak`, N."""
        return self._peak

    def clear_peak(self) -> None:
        """Start a new peak, at the start of a run."""
        self._peak = 0.0

    def check(
        self,
        *,
        epoch: int,
        episode: int,
        seq: int,
        time_s: float,
        wrench: FloatArray,
        raw: FloatArray,
        motion: FloatArray,
        saturated: bool,
        now: float,
    ) -> Verdict:
        """Judge one sample, on arrival.

        Args:
            epoch: identity of the source; 0 if it has none.
            episode: number of world resets; 0 if there are none.
            seq: sequence number, which increases within an episode.
            time_s: time stamp of the source, s. It is never used as an age, because clocks step.
            wrench: (6,) N, N·m at the TCP, base frame, not clipped.
            raw: (6,) N and N·m, the sensor's own reading in its own axes; a stuck channel hides in axes that turn.
            motion: any shape; the other numbers of the sample that the cell uses (pose, velocity). Only their
                finiteness and plausibility are judged.
            saturated: True if a raw channel is at the end of the sensor's range.
            now: time of arrival on the caller's monotonic clock, s.

        Returns:
            `PASSED`, `IGNORED` (a duplicate or an older sample, which refreshes nothing), or a fault.
        """
        limits = self._parameters
        if self._epoch is None:
            self._epoch, self._episode = epoch, episode
        elif epoch != self._epoch or episode != self._episode:
            return self._other_source(epoch, episode, now)
        elif seq <= self._seq:
            return IGNORED
        self._seq = seq

        channels: list[float] = wrench.tolist()
        if not is_plausible(channels):
            return Verdict(FaultCode.SENSOR_INVALID, text=f"wrench is not finite or not plausible: {channels}")
        own: list[float] = raw.tolist()
        moved: list[float] = [*own, *motion.ravel().tolist()]
        if not (isfinite(time_s) and is_plausible(moved)):
            return Verdict(
                FaultCode.SENSOR_INVALID,
                text="a raw reading, pose, velocity or time stamp is not finite or not plausible",
            )

        gap = 0.0 if self._time is None else time_s - self._time
        self._standing = 0 if self._time is None or gap > 0.0 else self._standing + 1
        self._time, self._arrival = time_s, now
        force = hypot(*channels[:3])
        self._force = force
        if force > self._peak:
            self._peak = force
        above = self._ceiling.judge(channels, saturated=saturated)
        if above.fault is not None:
            return above

        stuck = self._repeats.stuck(channels, limits.stuck_samples, limits.stuck_channel_samples)
        stuck_raw = self._raw_repeats.stuck(own, limits.stuck_samples, limits.stuck_channel_samples)
        if (found := stuck_raw or stuck) is not None:
            name, count, limit = found
            return Verdict(
                FaultCode.SENSOR_STUCK,
                count,
                limit,
                f"{name} of the {'sensor' if stuck_raw else 'wrench'} is bit-identical in {count} samples in a row "
                f"with fresh stamps, limit {limit}",
            )

        if self._standing >= STANDING_STAMPS:
            return Verdict(
                FaultCode.STALE,
                self._standing,
                STANDING_STAMPS,
                f"the time stamp has not advanced for {self._standing} samples: the source's clock has stopped",
            )
        if gap > limits.max_gap_s:
            return Verdict(
                FaultCode.STALE,
                gap,
                limits.max_gap_s,
                f"{gap * 1e3:.1f} ms between two samples, limit {limits.max_gap_s * 1e3:g} ms: "
                "what happened between them is unknown",
            )
        return PASSED

    def age(self, now: float) -> float:
        """Return the time since the newest accepted sample arrived, s; infinite before the first."""
        return now - self._arrival

    def overdue(self, now: float) -> Verdict:
        """Judge the time without a sample. Call it every tick, with or without a new sample."""
        age = now - self._arrival
        if age < self._parameters.max_age_s:
            return PASSED
        limit = self._parameters.max_age_s
        return Verdict(FaultCode.STALE, age, limit, f"no sample for {age * 1e3:.1f} ms, limit {limit * 1e3:g} ms")

    def _other_source(self, epoch: int, episode: int, now: float) -> Verdict:
        """Return the fault of a sample from another source. Such samples fail until `reset`."""
        if epoch == self._epoch:
            return Verdict(
                FaultCode.SOURCE,
                episode,
                self._episode,
                f"the world was laid out anew (episode {episode}, was {self._episode}) while in use",
            )
        age = now - self._arrival
        if age < self._parameters.max_age_s:
            return Verdict(
                FaultCode.SOURCE,
                age,
                self._parameters.max_age_s,
                f"two sources publish samples: epoch {epoch:#x}, and {self._epoch:#x} {age * 1e3:.1f} ms ago",
            )
        return Verdict(
            FaultCode.LINK,
            age,
            self._parameters.max_age_s,
            f"the source restarted: epoch {epoch:#x}, was {self._epoch:#x}, silent for {age * 1e3:.1f} ms",
        )
