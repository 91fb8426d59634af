"""A simulated cell in real time whose block stands too high and whose arm knows no ceiling of its own.

Run as a program: `python unlimited_world.py ENDPOINT WORLD`. The answer to `truth` has `largest_n`, the largest force
of the surroundings on the peg since the last layout, N.
"""

import sys
from typing import Any

import numpy as np

from sim_backend.zenoh_cell.cell import SimulatedCell
from sim_backend.zenoh_cell.server import Pace, Server
from wire.arrays import RecordArray
from wire.realtime import request_realtime
from wire.records import Kind
from wire.session import open_session
from wire.task import Task

CEILING_N = 1e3
SHIFT_M = (-0.025, -0.015, 0.04)
"""Displacement of the block, so that the peg meets its face on the way to the hole."""


class UnlimitedCell(SimulatedCell):
    largest_n = 0.0

    def reset(self, task: Task) -> RecordArray:
        super().reset(task)
        self.largest_n = 0.0
        world = self._world
        world.move_hole(np.array([0]), world.hole_position + np.array(SHIFT_M), world.hole_yaw)
        return self.state()

    def apply(self, command: RecordArray) -> None:
        if command["kind"] == Kind.ENGAGE:
            command["force_ceiling"] = CEILING_N
        super().apply(command)

    def tick(self, ticks: int = 1) -> RecordArray:
        record = super().tick(ticks)
        self.largest_n = max(self.largest_n, float(np.linalg.norm(self._world.contact_force[0])))
        return record

    def truth(self) -> dict[str, Any]:
        return {**super().truth(), "largest_n": self.largest_n}


def main(endpoint: str, world: str) -> None:
    refused = request_realtime()
    session = open_session(listen=[endpoint])
    cell = UnlimitedCell()
    cell.reset(Task(0))
    server = Server(cell, session, world, Pace.REAL_TIME, refused)
    print("ready", flush=True)
    server.run()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
