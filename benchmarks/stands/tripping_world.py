"""A simulated cell in real time that on request publishes some samples above the ceiling and times the stop.

Run `python -m benchmarks.stands.tripping_world ENDPOINT WORLD`. A query on `bench/trip` waits for a world that was laid
out after the last such samples, then for a random while. It is answered once the stop has arrived, with the seconds
from the first sample's publication to the stop's arrival.
"""

import random
import sys
import time

import zenoh

from sim_backend.zenoh_cell.cell import SimulatedCell
from sim_backend.zenoh_cell.server import Pace, Server
from wire import keys, records
from wire.arrays import RecordArray
from wire.realtime import request_realtime
from wire.session import close_session, open_session
from wire.task import Task

TRIP = "bench/trip"
FORCE_N = 100.0
AFTER_TICKS = (15, 60)
"""Shortest and longest time from the layout to the first sample: the run is under way, its arm not engaged yet."""
ABOVE_TICKS = 10
"""Samples above the ceiling in a row: publications may be lost on a loaded host, and a true force lasts as well."""


class TrippingCell(SimulatedCell):
    """Falsifies the force for a while, only in the record; the world itself continues unchanged."""

    def __init__(self) -> None:
        super().__init__()
        self._draws = random.Random(0)  # noqa: S311  # a seeded draw is wanted
        self._query: zenoh.Query | None = None
        self._due_seq: int | None = None
        self._left = 0
        self._published_s: float | None = None

    def trip(self, query: zenoh.Query) -> None:
        """Falsify samples of the present world, or of the next one; called on Zenoh's thread."""
        self._query, self._published_s = query, None

    def reset(self, task: Task) -> RecordArray:
        state = super().reset(task)
        self._due_seq = int(state["seq"][0]) + self._draws.randint(*AFTER_TICKS)
        return state

    def tick(self, ticks: int = 1) -> RecordArray:
        record = super().tick(ticks)
        if self._query is not None and self._due_seq is not None and record["seq"][0] >= self._due_seq:
            self._due_seq, self._left = None, ABOVE_TICKS
            self._published_s = time.perf_counter()
        if self._left > 0:
            self._left -= 1
            record["wrench"][0, 2] = FORCE_N
        return record

    def on_command(self, sample: zenoh.Sample) -> None:
        """Answer the query at the first stop after the sample; called on Zenoh's thread."""
        arrived_s = time.perf_counter()
        command = records.decode(sample.payload.to_bytes(), records.COMMAND)
        if self._published_s is None or self._query is None or command["kind"][0] != records.Kind.STOP:
            return
        query, self._query = self._query, None
        with query:
            query.reply(TRIP, repr(arrived_s - self._published_s), express=True)


def main(endpoint: str, world: str) -> None:
    refused = request_realtime()  # before Zenoh starts its threads, which inherit it
    session = open_session(listen=[endpoint])
    try:
        cell = TrippingCell()
        cell.reset(Task(0))
        session.declare_subscriber(keys.COMMAND.format(world=world), cell.on_command)
        session.declare_queryable(TRIP, cell.trip)
        server = Server(cell, session, world, Pace.REAL_TIME, refused)
        print("ready", flush=True)
        server.run()
    finally:
        close_session(session)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
