"""The samples of a resting arm before its run: what loads the tool, and what the joints feel without a load."""

from collections import deque

import numpy as np

from service.cell.plan import Plan
from service.drivers.base import Sample
from service.safety import preflight
from service.safety.verdict import Verdict
from service.safety.witness import Witness, check_rest
from wire.arrays import FloatArray


class Rest:
    """Collects consecutive samples of a resting arm.

    Args:
        plan: of the run.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._samples: deque[Sample] = deque(maxlen=plan.preflight.window_samples)

    @property
    def is_long_enough(self) -> bool:
        return len(self._samples) == self._samples.maxlen

    def add(self, sample: Sample) -> None:
        """Take in the next sample."""
        self._samples.append(sample)

    def clear(self) -> None:
        """Begin anew: the arm moved, or the sensor was zeroed."""
        self._samples.clear()

    def judge_load(self) -> Verdict:
        """Judge what loads the tool, by the sensor's own reading, never zeroed, and by the joints."""
        unzeroed, felt = np.array([sample.unzeroed for sample in self._samples]), self._felt()
        verdict = preflight.check_unzeroed(self._plan.preflight, unzeroed)
        if verdict.fault is None and felt is not None:
            verdict = check_rest(self._plan.witness, unzeroed, felt)
        return verdict

    def witness(self) -> Witness | None:
        """Return a witness whose offset is what the joints feel more than the zeroed sensor; None without joints."""
        felt = self._felt()
        if felt is None:
            return None
        sensed = np.array([sample.wrench[:3] for sample in self._samples])
        return Witness(self._plan.witness, self._plan.tick_s, felt.mean(0) - sensed.mean(0))

    def _felt(self) -> FloatArray | None:
        felt = [sample.joint_force for sample in self._samples if sample.joint_force is not None]
        return np.array(felt) if felt else None
