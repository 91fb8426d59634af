"""Control program of a cell: `control_program.urscript` with the names filled in from the configuration."""

import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import resources
from string import Template

from service.config import CellConfig, UrSection
from service.drivers.ur import registers
from service.safety.stop import STANDSTILL_M_S
from wire.records import Program, StopReason

STOP_S = 0.1
"""Time within which a stop's speed limit falls to zero, s, as in the simulated arm."""
FOLLOW_S = 0.02
"""Time constant with which the reference of a blind stop follows the arm, s, as in the simulated arm."""
RETRACT_SPEED_M_S = 0.02
SETTLE_S = 0.1
"""Time that a stop's confirmation needs beyond the stop itself, s: transport, and samples of a standing arm."""
ACCELERATION_M_S2 = 40.0
"""Acceleration argument of `speedl`; UR's own driver uses the same. The law's own accelerations stay far below."""
TURN_ACCELERATION_RAD_S2 = 200.0
CRC_MASK = 0x7FFF_FFFF
"""Mask of the checksum; the register that echoes it is a signed integer."""

_TEMPLATE = "control_program.urscript"


class ProgramError(ValueError):
    """The configuration yields no control program; the text names the field."""


@dataclass(frozen=True, slots=True)
class ControlProgram:
    """Program that is sent to the controller.

    Attributes:
        text: text in URScript.
        crc: checksum of the text, echoed by the running program; above zero.
    """

    text: str
    crc: int


def render(config: CellConfig) -> ControlProgram:
    """Make the control program of a cell.

    Args:
        config: configuration with a `ur` section.

    Raises:
        ProgramError: there is no such section, or a stop with its retract would exceed the time allowed for a stop.
    """
    ur = config.ur
    if ur is None:
        raise ProgramError("the configuration has no [ur] section: the control program needs payload and TCP")
    _check_stop(ur, config.limits.stop_confirm_s)
    limits, preflight = config.limits, config.preflight
    lower, upper = limits.workspace_m
    names = {
        **{name: str(number) for name, number in registers.script_names().items()},
        **{f"PROGRAM_{state.name}": str(int(state)) for state in Program},
        **{f"REASON_{reason.name}": str(int(reason)) for reason in StopReason},
        "MAX_STIFFNESS": _list(limits.max_stiffness),
        "MIN_DAMPING": _list(limits.min_damping),
        "MAX_DAMPING": _list(limits.max_damping),
        "MIN_INERTIA": _list(limits.min_inertia),
        "MAX_INERTIA": _list(limits.max_inertia),
        "MAX_SPEED": _number(limits.max_speed_m_s),
        "MAX_TURN_SPEED": _number(limits.max_turn_speed_rad_s),
        "MAX_STEP": _number(limits.max_step_m),
        "MAX_TURN": _number(limits.max_turn_rad),
        "MAX_FORCE": _number(limits.force_ceiling_n),
        "MAX_TORQUE": _number(limits.torque_ceiling_nm),
        "MAX_TARGET_AGE": _number(limits.target_age_s),
        "WORKSPACE_LOWER": _list(lower),
        "WORKSPACE_UPPER": _list(upper),
        "ZERO_MAX_FORCE": _number(preflight.unzeroed_force_n),
        "ZERO_MAX_TORQUE": _number(preflight.unzeroed_torque_nm),
        "ZERO_MAX_SPEED": _number(STANDSTILL_M_S),
        "STOP_TIME": _number(STOP_S),
        "FOLLOW_TIME": _number(FOLLOW_S),
        "RETRACT": _number(ur.stop_retract_m),
        "RETRACT_SPEED": _number(RETRACT_SPEED_M_S),
        "ACCELERATION": _number(ACCELERATION_M_S2),
        "TURN_ACCELERATION": _number(TURN_ACCELERATION_RAD_S2),
        "TORQUE_ABOUT_FLANGE": str(ur.torque_about == "flange"),
        "TCP": f"p{_list(ur.tcp_m)}",
        "PAYLOAD_KG": _number(ur.payload_kg),
        "PAYLOAD_COM": _list(ur.payload_com_m),
        "WATCHDOG_HZ": _number(ur.watchdog_hz),
    }
    template = Template(resources.files("service.drivers.ur").joinpath(_TEMPLATE).read_text(encoding="utf-8"))
    crc = zlib.crc32(template.substitute(names, CRC="0").encode()) & CRC_MASK or 1
    return ControlProgram(template.substitute(names, CRC=str(crc)), crc)


def _check_stop(ur: UrSection, stop_confirm_s: float) -> None:
    lasts_s = STOP_S + ur.stop_retract_m / RETRACT_SPEED_M_S + SETTLE_S
    if lasts_s > stop_confirm_s:
        longest_m = max(0.0, (stop_confirm_s - STOP_S - SETTLE_S) * RETRACT_SPEED_M_S)
        raise ProgramError(
            f"ur.stop_retract_m is {ur.stop_retract_m}: a stop with it takes {lasts_s:.2f} s, longer than "
            f"limits.stop_confirm_s ({stop_confirm_s} s); at most {longest_m:.4f} m fit"
        )


def _number(value: float) -> str:
    """Return a number that URScript reads back as the same floating-point number."""
    return repr(float(value))


def _list(values: Iterable[float]) -> str:
    return f"[{', '.join(_number(value) for value in values)}]"
