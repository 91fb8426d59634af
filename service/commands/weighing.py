"""`ur weigh`: leads an operator through the attitudes of a weighing, and reports what it found."""

from collections.abc import Callable, Iterator
from contextlib import aclosing
from typing import Any

import numpy as np
from rich.table import Table

from service.config import UrSection
from service.drivers.ur.weighing import weighings
from service.safety.weighing import AXES, CHANNELS, MIN_ATTITUDES, MIN_TURN_RAD, Weighing
from wire.arrays import FloatArray

BEGIN = (
    f"Jog the arm with the pendant, to {MIN_ATTITUDES} attitudes or more, and let it stand for two seconds at each. "
    "Touch neither the tool nor its cables. Begin with the tool straight down."
)

_MIN_TURN = f"{np.degrees(MIN_TURN_RAD):.0f}°"


async def weigh(ur: UrSection, tell: Callable[[str], None]) -> Weighing:
    """Wait at the arm until every axis is proven.

    Args:
        ur: section of the configuration.
        tell: says what was taken, and what to do next.

    Raises:
        DriverError: the controller cannot be reached or was lost; it is another robot; its arm has no power or is
            stopped for safety.
    """

    def tell_near(turned_rad: float) -> None:
        tell(
            f"only {np.degrees(turned_rad):.0f}° from an attitude that was taken, {_MIN_TURN} needed: turn the tool on"
        )

    tell(BEGIN)
    async with aclosing(weighings(ur, tell_near)) as stream:
        while True:
            weighing = await anext(stream)
            for line in _progress(weighing):
                tell(line)
            if weighing.complete:
                return weighing


def tables(weighing: Weighing) -> tuple[Table, Table]:
    """Return axes and attitudes as tables for people."""
    scale = weighing.scale
    axes = Table("axis", f"weight shown, at least {scale.needed_n:g} N", *(f"gain of {name}" for name in CHANNELS[:3]))
    for column, name in enumerate(AXES):
        axes.add_row(name, f"{weighing.shown_n[column]:.1f} N", *(f"{gain:z.2f}" for gain in weighing.gain[:, column]))
    attitudes = Table(
        "attitude",
        "down, in the flange's axes",
        f"force off, limit {scale.limit_n:g} N",
        f"torque off, limit {scale.limit_nm:g} N·m",
    )
    for number, (rest, residual) in enumerate(zip(weighing.rests, weighing.residuals, strict=True), start=1):
        force_n, torque_nm = _lengths(residual)
        attitudes.add_row(str(number), _list(rest.down), f"{force_n:.2f} N", f"{torque_nm:.3f} N·m")
    return axes, attitudes


def payload_line(weighing: Weighing) -> str:
    """Return mass and centre of the payload, as weighed and as configured."""
    configured = weighing.scale.payload
    mass = (
        f"payload: {weighing.mass_kg:.2f} kg by the sensor, about {weighing.joints_kg:.2f} kg by the joints, "
        f"{configured.mass_kg:g} kg configured"
    )
    if not weighing.forces_are_right:
        return mass
    found_mm, configured_mm = (1e3 * np.array(centre) for centre in (weighing.centre_m, configured.centre_m))
    return f"{mass}; centre {_list(found_mm, 0)} mm by the torques, {_list(configured_mm, 0)} mm configured"


def outcome(weighing: Weighing) -> tuple[str, ...]:
    """Return everything that is wrong, or what is proven."""
    unproven = ", ".join(weighing.unproven_torques)
    beside = f"; not proven, since the weight has no lever about them: {unproven}" if unproven else ""
    return weighing.findings or (f"every axis is proven: the sensor shows the configured payload{beside}",)


def document(weighing: Weighing) -> dict[str, Any]:
    """Return the weighing as JSON for other programs."""
    scale = weighing.scale
    return {
        "passed": weighing.passed,
        "findings": list(weighing.findings),
        "axes": {
            name: {"shown_n": float(shown_n), "proven": proven, "gain": weighing.gain[:, column].tolist()}
            for column, (name, shown_n, proven) in enumerate(zip(AXES, weighing.shown_n, weighing.proven, strict=True))
        },
        "unproven_torques": list(weighing.unproven_torques),
        "needed_n": scale.needed_n,
        "attitudes": [
            {"down": rest.down.tolist(), "raw": rest.wrench.tolist(), "off_n": force_n, "off_nm": torque_nm}
            for rest, residual in zip(weighing.rests, weighing.residuals, strict=True)
            for force_n, torque_nm in [_lengths(residual)]
        ],
        "limit_n": scale.limit_n,
        "limit_nm": scale.limit_nm,
        "payload": {
            "configured_kg": scale.payload.mass_kg,
            "sensor_kg": weighing.mass_kg,
            "joints_kg": weighing.joints_kg,
            "configured_centre_m": list(scale.payload.centre_m),
            "centre_m": list(weighing.centre_m) if weighing.forces_are_right else None,
        },
    }


def _progress(weighing: Weighing) -> Iterator[str]:
    taken, newest = len(weighing.rests), weighing.rests[-1]
    yield (
        f"attitude {taken} taken: down is along {_list(newest.down)} of the flange, raw force "
        f"{_list(newest.wrench[:3])} N"
    )
    if weighing.complete:
        return
    if taken >= MIN_ATTITUDES:
        shown = ", ".join(f"{name} {shown_n:.1f} N" for name, shown_n in zip(AXES, weighing.shown_n, strict=True))
        yield f"weight shown so far: {shown}; each axis needs {weighing.scale.needed_n:g} N"
    yield from weighing.findings
    axis = weighing.next_axis()
    way = "up" if axis.startswith("-") else "down"
    yield f"next: turn the tool until the flange's {axis[-1]} axis points {way}, or as far that way as the arm goes"


def _lengths(residual: FloatArray) -> tuple[float, float]:
    return float(np.linalg.norm(residual[:3])), float(np.linalg.norm(residual[3:]))


def _list(values: FloatArray, digits: int = 2) -> str:
    return "[" + ", ".join(f"{value:z.{digits}f}" for value in values.tolist()) + "]"
