"""Translates between the driver interface and a simulated cell's records: states to samples, orders to commands."""

import secrets

import numpy as np

from service.drivers.base import DriverError, PoseTarget, Sample
from service.faults import FaultCode
from wire import records
from wire.arrays import RecordArray
from wire.law import ComplianceLaw, ControlLimits
from wire.task import Task

BRAKE_WORD = secrets.randbits(63) | 1
"""Word of this process's watchdog, which may stop the simulated world that this process holds, and nothing else."""


def read_sample(record: RecordArray, arrival_s: float) -> Sample:
    """Turn one state into a sample that shares no memory with it.

    Args:
        record: (1,) record of `records.STATE`.
        arrival_s: time of arrival on the driver's clock, s.

    Raises:
        records.WireError: a field holds a value that the schema lacks. The monitor judges whether numbers are finite.
    """
    row = record[0]
    if row["kind"] != records.Kind.STATE:
        raise records.WireError(f"kind {int(row['kind'])} on a state key")
    try:
        program, stop_reason = records.Program(int(row["program"])), records.StopReason(int(row["stop_reason"]))
    except ValueError as error:
        raise records.WireError(str(error)) from error
    estimate = row["hole_estimate"].copy()
    return Sample(
        epoch=int(row["epoch"]),
        episode=int(row["episode"]),
        seq=int(row["seq"]),
        time_s=float(row["time_s"]),
        arrival_s=arrival_s,
        q=row["q"].copy(),
        qd=row["qd"].copy(),
        tcp_position=row["tcp_position"].copy(),
        tcp_rotvec=row["tcp_rotvec"].copy(),
        tcp_velocity=row["tcp_velocity"].copy(),
        wrench=row["wrench"].copy(),
        unzeroed=row["unzeroed"].copy(),
        ft_raw=row["ft_raw"].copy(),
        joint_force=row["joint_force"].copy(),
        saturated=bool(row["saturated"]),
        hole_estimate=estimate if bool(np.isfinite(estimate).all()) else None,
        program=program,
        stop_reason=stop_reason,
        robot_mode=int(row["robot_mode"]),
        safety_mode=int(row["safety_mode"]),
        command_seq=int(row["command_seq"]),
        peak_force_n=float(row["peak_force"]),
    )


def check_task(task: Task | None) -> Task:
    """Check that a world can be built from a task, and return the task.

    Raises:
        DriverError: PROTOCOL: there is no task, or a field of it is wrong; the text names the field.
    """
    if task is None:
        raise DriverError(FaultCode.PROTOCOL, "a simulated world needs a task to lay out")
    try:
        task.check()
    except ValueError as error:
        raise DriverError(FaultCode.PROTOCOL, f"the recipe asks for a world that cannot be built: {error}") from error
    return task


class CommandWriter:
    """Writes the commands of one client to one world, numbered.

    Attributes:
        epoch: epoch of the addressed world; set on connecting.
        client: word of the claim on that world; set on connecting.
    """

    def __init__(self) -> None:
        self.epoch = 0
        self.client = secrets.randbits(63)
        self._seq = 0

    def engage(self, law: ComplianceLaw, limits: ControlLimits) -> RecordArray:
        record = self._new(records.Kind.ENGAGE)
        row = record[0]
        row["stiffness"], row["damping"], row["inertia"] = law.stiffness, law.damping, law.inertia
        row["max_speed"], row["max_step"], row["workspace"] = limits.max_speed, limits.max_step, limits.workspace
        row["force_ceiling"], row["target_age"] = limits.force_ceiling_n, limits.target_age_s
        return record

    def target(self, target: PoseTarget) -> RecordArray:
        record = self._new(records.Kind.TARGET)
        record[0]["position"], record[0]["rotvec"] = target.position, target.rotvec
        return record

    def stop(self, *, blind: bool = False) -> RecordArray:
        return self._new(records.Kind.STOP_BLIND if blind else records.Kind.STOP)

    def zero_ft(self) -> RecordArray:
        return self._new(records.Kind.ZERO_FT)

    def unlock(self) -> RecordArray:
        return self._new(records.Kind.UNLOCK)

    @property
    def seq(self) -> int:
        """Number of the last command written."""
        return self._seq

    def _new(self, kind: records.Kind) -> RecordArray:
        self._seq += 1
        record = records.new(records.COMMAND, kind)
        row = record[0]
        row["client"], row["epoch"], row["seq"] = self.client, self.epoch, self._seq
        return record
