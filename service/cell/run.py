"""One run under way: carries out what its insertion orders, and says how it stands."""

from typing import Protocol

import numpy as np
import numpy.typing as npt
import structlog

from service.cell.inference import Inference, InferenceKind
from service.cell.insertion import Insertion
from service.cell.plan import Plan
from service.cell.records import (
    Disengage,
    Engage,
    Enter,
    Fail,
    Halt,
    Infer,
    Move,
    Order,
    Succeed,
    TickRecord,
    ZeroFt,
)
from service.drivers.base import Driver, Sample
from service.faults import FaultCode
from service.messages import CellState, Run
from service.policy.model import Policy, PolicyError

_log = structlog.get_logger("service.cell")


class RunHost(Protocol):
    """The cell, as its run sees it."""

    def enter(self, state: CellState) -> None: ...

    def halt(self, code: FaultCode, text: str) -> None:
        """Stop and latch; the run is abandoned before this returns."""
        ...

    def disengage(self) -> None:
        """Stop the arm as the ordinary end of the run, and finish once that is confirmed."""
        ...

    def on_tick(self, record: TickRecord) -> None: ...


class ActiveRun:
    """One accepted run, until it has ended.

    Args:
        run: as accepted.
        driver: of the arm.
        host: takes what the run wants of the cell.

    Attributes:
        outcome: set once the insertion has decided; the arm may still be moving away.
        insertion: None before the world is prepared.
    """

    def __init__(self, run: Run, driver: Driver, host: RunHost) -> None:
        self.accepted = run
        self.outcome: Succeed | Fail | None = None
        self.insertion: Insertion | None = None
        self._driver = driver
        self._host = host
        self._inference: Inference | None = None
        self._abandoned = False

    @property
    def abandoned(self) -> bool:
        return self._abandoned

    def begin(self, plan: Plan, policy: Policy, kind: InferenceKind) -> None:
        """From the next sample on, insert."""
        self.insertion = Insertion(plan)
        self._inference = kind(policy, self._take_action, self._take_failure)

    def on_sample(self, sample: Sample) -> None:
        """Take in a sample that the monitor has passed."""
        if self.insertion is not None:
            self._carry_out(self.insertion.on_sample(sample))

    def abandon(self) -> None:
        """From now on nothing of this run reaches the arm."""
        self._abandoned = True
        if self._inference is not None:
            self._inference.close()

    def snapshot(self, peak_force_n: float, now_s: float) -> Run:
        """Say how the run stands.

        Args:
            peak_force_n: so far.
            now_s: the samples' clock.
        """
        insertion = self.insertion
        if insertion is None:
            return self.accepted
        return self.accepted.model_copy(
            update={
                "phase": insertion.phase,
                "steps": insertion.steps,
                "depth_m": insertion.depth_m,
                "peak_force_n": peak_force_n,
                "duration_s": insertion.duration_s(now_s),
            }
        )

    def _carry_out(self, orders: list[Order]) -> None:
        for order in orders:
            if self._abandoned:
                return
            match order:
                case Move(target):
                    self._driver.send_target(target)
                case Infer(observation):
                    if self._inference is not None:
                        self._inference.ask(observation)
                case Enter(state):
                    self._host.enter(state)
                case ZeroFt():
                    self._driver.zero_ft()
                case Engage(law, limits):
                    self._driver.engage(law, limits)
                case Succeed() | Fail():
                    self.outcome = order
                case Disengage():
                    self._host.disengage()
                case Halt(code, text):
                    self._host.halt(code, text)

    def _take_action(self, action: npt.NDArray[np.float32]) -> None:
        if self._abandoned or self.insertion is None:
            return
        before = self.insertion.steps
        try:
            self._carry_out(self.insertion.take_action(action))
        except Exception as error:
            self._host.halt(FaultCode.INTERNAL, f"{type(error).__name__}: {error}")
            _log.exception("action", run=self.accepted.id)
        if self.insertion.steps > before and self.insertion.last is not None:
            self._host.on_tick(self.insertion.last)

    def _take_failure(self, error: Exception) -> None:
        if self._abandoned:
            return
        if isinstance(error, PolicyError):
            self._host.halt(FaultCode.POLICY_INVALID, f"the policy gave nothing usable: {error}")
        else:
            self._host.halt(FaultCode.INTERNAL, f"inference failed with {type(error).__name__}: {error}")
            _log.error("inference", exc_info=error)
