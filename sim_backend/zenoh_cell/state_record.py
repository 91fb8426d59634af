"""The state of a simulated cell as a record of the wire, filled through views that are made once."""

from collections.abc import Mapping

import numpy as np

from sim_backend.world.joint_sense import JointSense
from sim_backend.world.telling import REPORT
from sim_backend.world.world import World
from wire.arrays import RecordArray
from wire.records import STATE, Kind, Program, new
from wire.rtde.modes import RobotMode, SafetyMode

_NORMAL, _STOPPED = int(SafetyMode.NORMAL), int(SafetyMode.PROTECTIVE_STOP)


class StateRecord:
    """One `records.STATE` that is written anew at every tick."""

    def __init__(self) -> None:
        record = new(STATE, Kind.STATE)
        record["robot_mode"] = RobotMode.RUNNING
        self._bytes = np.frombuffer(bytearray(record.tobytes()), np.uint8)
        written = self._bytes.view(STATE)
        self._views = {name: written[name] for name in STATE.names or ()}
        self._report = tuple(self._views[name] for name in REPORT)

    def write(self, world: World, sense: JointSense, counters: Mapping[str, float]) -> RecordArray:
        """Return a copy of the record, (1,), with the present state of a world of one cell.

        Args:
            world: world of one cell.
            sense: its drives.
            counters: fields that the cell counts itself, by name.
        """
        views, arm, sensor = self._views, world.arm, world.sensor
        for name, value in counters.items():
            views[name][0] = value
        world.telling.write(self._report)
        sensor.unzeroed(world.rotation, views["unzeroed"])
        program = int(arm.program[0])
        views["program"][0], views["stop_reason"][0] = program, arm.stop_reason[0]
        views["safety_mode"][0] = _STOPPED if program == Program.PROTECTIVE_STOP else _NORMAL
        views["saturated"][0] = sensor.saturated[0]
        views["joint_force"][0] = sense.force
        return self._bytes.copy().view(STATE)  # numpy copies a record field by field, and bytes at once
