"""The control process with one addition: it records when its loop judges each sample, and each policy step.

Run `python -m benchmarks.stands.watched_service OUTPUT`; the environment gives the configuration. At the end it writes
tables, in s, to OUTPUT (`.npz`):

- `late`, one number per sample: from its arrival in the transport's thread to the end of its judgement.
- `judged`, one row per sample: its time stamp by the arm's clock, and the end of its judgement by the host's clock.
- `steps`, one row per policy step that led to a command: time stamp of its sample by the arm's clock, the sample's
  arrival and the command's departure by the host's monotonic clock, and the time for which the loop was held.
"""

import sys
from pathlib import Path

import numpy as np

from benchmarks.harness.stopwatch import Stopwatch, timed
from service.cell.cell import Cell
from service.cell.policy_process import WorkerInference
from service.commands.control import control
from service.drivers.base import Sample
from service.drivers.ur.driver import UrDriver
from service.drivers.zenoh_sim import ZenohSimDriver
from wire.arrays import FloatArray


def policy_steps(
    stamps: list[tuple[float, float]], judged: Stopwatch, asked: Stopwatch, answered: Stopwatch, sent: Stopwatch
) -> FloatArray:
    """Return the rows of `steps`.

    Args:
        stamps: time stamp and arrival of each sample, s.
        judged: calls that judge them.
        asked: calls of the policy, within those.
        answered: calls that take its answers.
        sent: calls that send targets, within those where the answer led to one.
    """
    begins = [begin for begin, _ in judged.calls]
    answers, departures = np.array(answered.calls).reshape(-1, 2), np.array([end for _, end in sent.calls])
    rows: list[tuple[float, ...]] = []
    nexts = [begin for begin, _ in asked.calls[1:]] + [float("inf")]
    for (begin, end), next_s in zip(asked.calls, nexts, strict=True):
        number = int(np.searchsorted(begins, begin)) - 1
        after = np.flatnonzero((answers[:, 0] >= end) & (answers[:, 0] < next_s))  # a run may end without an answer
        if number < 0 or not len(after):
            continue
        first, last = answers[after[0]]
        within = departures[(departures >= first) & (departures <= last)]
        if len(within):
            judged_s = judged.calls[number][1] - judged.calls[number][0]
            rows.append((*stamps[number], within[0], judged_s + last - first))
    return np.array(rows).reshape(-1, 4)


def main(output: Path) -> None:
    late_s: list[float] = []
    judged_s: list[tuple[float, float]] = []
    stamps: list[tuple[float, float]] = []
    judge = Cell.on_sample

    def on_sample(self: Cell, sample: Sample) -> None:
        stamps.append((sample.time_s, sample.arrival_s))
        judge(self, sample)
        now_s = self.driver.clock()
        late_s.append(now_s - sample.arrival_s)
        judged_s.append((sample.time_s, now_s))

    Cell.on_sample = on_sample
    with (
        timed(Cell, "on_sample") as judged,
        timed(WorkerInference, "ask") as asked,
        timed(WorkerInference, "_read") as answered,
        timed(ZenohSimDriver, "send_target") as published,
        timed(UrDriver, "send_target") as written,
    ):
        try:
            control(None)
        finally:
            sent = published if published.calls else written
            steps = policy_steps(stamps, judged, asked, answered, sent)
            np.savez(output, late=np.array(late_s), judged=np.array(judged_s), steps=steps)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
