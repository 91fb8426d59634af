"""Reports for people, made from samples: measured values and telemetry points."""

import numpy as np

from service.cell.insertion import Insertion
from service.drivers.base import Sample
from service.messages import CellState, Measured, Telemetry
from service.safety.stop import STANDSTILL_M_S, STANDSTILL_RAD_S


def _three(vector: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in vector[:3])
    return x, y, z


def measured(sample: Sample, now: float) -> Measured:
    """Report the newest sample.

    Args:
        sample: finite.
        now: time on the clock that stamped its arrival.
    """
    speed = float(np.linalg.norm(sample.tcp_velocity[:3]))
    joints = float(np.abs(sample.qd).max())
    return Measured(
        sample_age_s=max(0.0, now - sample.arrival_s),
        sample_seq=sample.seq,
        force_n=_three(sample.wrench),
        torque_nm=_three(sample.wrench[3:]),
        force_magnitude_n=float(np.linalg.norm(sample.wrench[:3])),
        tcp_position_m=_three(sample.tcp_position),
        tcp_speed_m_s=speed,
        moving=speed > STANDSTILL_M_S or joints > STANDSTILL_RAD_S,
        program=sample.program.name,
        robot_mode=sample.robot_mode,
        safety_mode=sample.safety_mode,
    )


def telemetry(
    sample: Sample, force_peak_n: float, state: CellState, insertion: Insertion | None, run_id: str | None
) -> Telemetry:
    """Return one point of the live plot; `force_peak_n` is the peak of all samples since the last point."""
    return Telemetry(
        t=sample.time_s,
        force_n=_three(sample.wrench),
        force_magnitude_n=float(np.linalg.norm(sample.wrench[:3])),
        force_peak_n=force_peak_n,
        tcp_z_m=float(sample.tcp_position[2]),
        z_lock_m=None if insertion is None else insertion.z_lock_m,
        depth_m=None if insertion is None else insertion.depth_m,
        phase=None if insertion is None else insertion.phase,
        state=state,
        run_id=run_id,
    )
