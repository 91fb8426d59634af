"""Standstill after a stop: confirmed by measurement. The stop is repeated, and escalated at its deadline."""

from service.drivers.base import Driver, Program, Sample
from service.safety.stop import StopConfirmation, StopParameters, StopState
from service.safety.witness import Witness

STOP_AGAIN_TICKS = 5
"""Samples between two stop commands to an arm that stays engaged."""


class Standstill:
    """Waits for the arm to stand still after a stop command.

    Args:
        driver: of the arm.
        deadline_s: time in which standstill must be measured.
    """

    def __init__(self, driver: Driver, deadline_s: float) -> None:
        self._driver = driver
        self._parameters = StopParameters(deadline_s=deadline_s)
        self._confirmation: StopConfirmation | None = None
        self._witness: Witness | None = None
        self._is_blind = False

    @property
    def awaited(self) -> bool:
        """True from `begin` to `end`."""
        return self._confirmation is not None

    def begin(self, witness: Witness | None = None, *, blind: bool = False) -> None:
        """Start waiting; a stop command has just left.

        Args:
            witness: goes on comparing the sensor with the joints. An arm yields to its sensor while it stops, so a
                sensor that lies turns the stop into a push; the stop then becomes blind.
            blind: the command was not to yield to the sensor.
        """
        self._witness, self._is_blind = witness, blind
        self._confirmation = StopConfirmation(self._parameters, self._driver.clock())

    def end(self) -> None:
        """Wait no longer."""
        self._confirmation = None

    def on_sample(self, sample: Sample) -> StopState:
        """Take in a sample; return how the stop stands. An unconfirmed stop has been escalated."""
        if self._confirmation is None:
            return StopState.WAITING
        if self._witness is not None and self._witness.check(sample.wrench, sample.joint_force).fault is not None:
            self.disbelieve()
        self.repeat_stop(sample)
        if sample.program in (Program.ENGAGED, Program.STOPPING):
            # An arm whose program may go on does not count as standing
            return self._escalated(self._confirmation.check(sample.arrival_s))
        return self._escalated(self._confirmation.observe(sample.tcp_velocity, sample.arrival_s))

    def on_silence(self, now: float) -> StopState:
        """Judge the deadline without a sample; return how the stop stands, as `on_sample` does.

        Args:
            now: of the driver's clock.
        """
        if self._confirmation is None:
            return StopState.WAITING
        return self._escalated(self._confirmation.check(now))

    def repeat_stop(self, sample: Sample) -> None:
        """Send the stop command again while the arm stays engaged."""
        if sample.program is Program.ENGAGED and sample.seq % STOP_AGAIN_TICKS == 0:
            self.stop()

    def disbelieve(self) -> None:
        """Make the stop under way a blind one."""
        if not self._is_blind:
            self._is_blind = True
            self.stop()

    def stop(self) -> None:
        """Send the stop command again; a blind one stays blind."""
        if self._is_blind:
            self._driver.stop_blind()
        else:
            self._driver.stop()

    def _escalated(self, stop: StopState) -> StopState:
        if stop is StopState.UNCONFIRMED:
            self._driver.escalate()
        return stop
