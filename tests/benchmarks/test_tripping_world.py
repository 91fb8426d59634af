"""The stand of `stop_latency`: what it does to the samples of its world."""

from typing import cast

import zenoh

from benchmarks.stands.tripping_world import ABOVE_TICKS, AFTER_TICKS, FORCE_N, TrippingCell
from wire.task import Task


def test_a_trip_lasts_for_some_samples_so_that_a_lost_one_is_no_lost_stop() -> None:
    cell = TrippingCell()
    cell.reset(Task(0))
    cell.trip(cast(zenoh.Query, object()))
    forces = [float(cell.tick()["wrench"][0, 2]) for _ in range(AFTER_TICKS[1] + 2 * ABOVE_TICKS)]
    above = [tick for tick, force in enumerate(forces, 1) if force == FORCE_N]
    assert above == list(range(above[0], above[0] + ABOVE_TICKS)), "and then the cell can be reset"
    assert AFTER_TICKS[0] <= above[0] <= AFTER_TICKS[1]
