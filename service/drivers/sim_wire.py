"""Translates between the driver interface and a simulated cell's records: states to samples, orders to commands."""

import math
import secrets
import struct
from typing import Any, cast

import numpy as np

from service.drivers.base import DriverError, Load, PoseTarget, Sample
from service.faults import FaultCode
from wire import records
from wire.arrays import RecordArray
from wire.law import ComplianceLaw, ControlLimits
from wire.task import Task

BRAKE_WORD = secrets.randbits(63) | 1
"""Word of this process's watchdog, which may stop the simulated world that this process holds, and nothing else."""

_FIELDS = cast("dict[str, Any]", records.STATE.fields)
_HEAD = struct.Struct("<IHHQQQd")
"""A state up to `time_s`."""
_TAIL = struct.Struct("<QQHHhhH")
"""A state from `command_seq` to `saturated`."""
_TAIL_AT = _FIELDS["command_seq"][1]
_HEAD_OF_A_STATE = records.MAGIC, records.VERSION, int(records.Kind.STATE)
_SIGNATURE = struct.Struct("<QQQ")
"""A command's `client`, `epoch` and `seq`, after its header."""
_SIGNATURE_AT = 8
_BLANK = {kind: records.new(records.COMMAND, kind).tobytes() for kind in records.Kind}


def _numbers(name: str) -> slice:
    """Return the place of a field of a state among its eight-byte numbers."""
    kind, offset = _FIELDS[name][:2]
    return slice(offset // 8, (offset + kind.itemsize) // 8)


_Q, _QD, _VELOCITY = map(_numbers, ("q", "qd", "tcp_velocity"))
_POSITION, _ROTVEC, _ESTIMATE = map(_numbers, ("tcp_position", "tcp_rotvec", "hole_estimate"))
_WRENCH, _UNZEROED, _FT_RAW, _JOINTS = map(_numbers, ("wrench", "unzeroed", "ft_raw", "joint_force"))
_PEAK = _numbers("peak_force").start
_WRENCH_NUMBERS = struct.Struct("<6d")
_WRENCH_AT = _FIELDS["wrench"][1]


def read_load(state: bytes) -> Load:
    """Return the part of a state that the ceilings are judged by, in a fraction of the time of `read_sample`.

    Args:
        state: one record of `records.STATE`.

    Raises:
        records.WireError: it is not one state of this schema.
    """
    _, _, _, epoch, *_ = _read_head(state)
    _, _, program, _, _, _, saturated = _TAIL.unpack_from(state, _TAIL_AT)
    wrench = _WRENCH_NUMBERS.unpack_from(state, _WRENCH_AT)
    return Load(epoch, wrench, bool(saturated), program == records.Program.ENGAGED)


def read_sample(state: bytes, arrival_s: float) -> Sample:
    """Turn one state into a sample. Its arrays are read-only views of `state`.

    It reads the bytes by their offsets, which takes a fifth of the time of numpy's access by field.

    Args:
        state: one record of `records.STATE`.
        arrival_s: time of arrival on the driver's clock, s.

    Raises:
        records.WireError: it is not one state of this schema, or a field holds a value that the schema lacks. The
            monitor judges whether numbers are finite.
    """
    _, _, _, epoch, episode, seq, time_s = _read_head(state)
    command_seq, _, program, stop_reason, robot_mode, safety_mode, saturated = _TAIL.unpack_from(state, _TAIL_AT)
    numbers = np.frombuffer(state, "<f8")
    estimate = numbers[_ESTIMATE]
    try:
        return Sample(
            epoch=epoch,
            episode=episode,
            seq=seq,
            time_s=time_s,
            arrival_s=arrival_s,
            q=numbers[_Q],
            qd=numbers[_QD],
            tcp_position=numbers[_POSITION],
            tcp_rotvec=numbers[_ROTVEC],
            tcp_velocity=numbers[_VELOCITY],
            wrench=numbers[_WRENCH],
            unzeroed=numbers[_UNZEROED],
            ft_raw=numbers[_FT_RAW],
            joint_force=numbers[_JOINTS],
            saturated=bool(saturated),
            hole_estimate=estimate if all(map(math.isfinite, estimate.tolist())) else None,
            program=records.Program(program),
            stop_reason=records.StopReason(stop_reason),
            robot_mode=robot_mode,
            safety_mode=safety_mode,
            command_seq=command_seq,
            peak_force_n=float(numbers[_PEAK]),
        )
    except ValueError as error:
        raise records.WireError(str(error)) from error


def _read_head(state: bytes) -> tuple[int, int, int, int, int, int, float]:
    """Return magic, version, kind, epoch, episode, seq and time of a state.

    Raises:
        records.WireError: it is not one state of this schema.
    """
    if len(state) != records.STATE.itemsize:
        raise records.WireError(f"{len(state)} bytes are not one state of {records.STATE.itemsize} bytes")
    head = _HEAD.unpack_from(state)
    if head[:3] != _HEAD_OF_A_STATE:
        records.decode(state, records.STATE)  # says which is wrong, where it is magic or version
        raise records.WireError(f"kind {head[2]} on a state key")
    return head


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
        payload = bytearray(_BLANK[kind])
        _SIGNATURE.pack_into(payload, _SIGNATURE_AT, self.client, self.epoch, self._seq)
        return np.frombuffer(payload, records.COMMAND)
