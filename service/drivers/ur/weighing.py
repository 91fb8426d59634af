"""Reads the force/torque sensor wherever an arm comes to stand that somebody else moves.

It only reads: it opens no input recipe and sends no program, so it commands, zeroes and configures nothing, and works
beside a cell that holds the controller's registers.
"""

import asyncio
from collections.abc import AsyncGenerator, Callable
from dataclasses import replace

import numpy as np

from service.config import UrSection
from service.drivers.base import DriverError
from service.drivers.ur import gate
from service.drivers.ur.driver import STANDSTILL_RAD_S
from service.drivers.ur.link import LINK_FAULTS, RATE_HZ
from service.drivers.ur.rtde import RtdeClient
from service.drivers.ur.samples import OUTPUTS, Package, flange_rotation
from service.faults import FaultCode
from service.safety.weighing import GRAVITY_M_S2, MIN_TURN_RAD, Payload, Rest, Scale, Weighing
from wire.rtde.codec import Decoded
from wire.rtde.errors import RtdeError
from wire.rtde.modes import RobotMode

SETTLE_S = 0.5
"""Rest before the reading, s: the arm swings out, and the sensor is late."""
WINDOW_S = 1.0
"""Time over which a reading is taken, s."""
CHECKED = frozenset({"PolyScope", "robot", "safety mode", "robot mode"})
"""Checks of the gate that precede a weighing. Remote control is none of them: the operator moves the arm at the
pendant.
"""


class RestReader:
    """Takes one window of raw readings out of every rest of the arm.

    Args:
        scale: instrument and load.
    """

    def __init__(self, scale: Scale) -> None:
        self._scale = scale
        self._since_s: float | None = None
        self._taken = False
        self._raw: list[tuple[float, ...]] = []
        self._felt_n: list[float] = []

    def feed(self, package: Package) -> Rest | None:
        """Take a package; return the rest whose window it completes, once per rest."""
        if package.robot_mode != RobotMode.RUNNING or not all(abs(speed) < STANDSTILL_RAD_S for speed in package.qd):
            self._since_s = None
            return None
        if self._since_s is None:
            self._since_s, self._taken, self._raw, self._felt_n = package.time_s, False, [], []
        rested_s = package.time_s - self._since_s
        if self._taken or rested_s < SETTLE_S:
            return None
        self._raw.append(package.ft_raw)
        self._felt_n.append(package.felt[2])
        if rested_s < SETTLE_S + WINDOW_S:
            return None
        self._taken = True
        joints_kg = package.payload_kg - float(np.mean(self._felt_n)) / GRAVITY_M_S2
        return Rest.of(self._scale, np.array(self._raw), -flange_rotation(package)[2], joints_kg)


def scale_of(ur: UrSection) -> Scale:
    """Return the instrument and the load that the configuration describes."""
    return Scale(Payload(ur.payload_kg, ur.payload_com_m), ur.force_range_n, ur.torque_range_nm)


async def weighings(ur: UrSection, on_near: Callable[[float], None]) -> AsyncGenerator[Weighing]:
    """Yield the weighing of all attitudes so far, each time the arm has stood at a new one. It does not end by itself.

    Args:
        ur: section of the configuration.
        on_near: receives the angle, rad, to the nearest attitude taken so far, where the arm stands too near to it.

    Raises:
        DriverError: the controller cannot be reached or was lost; it is another robot; its arm has no power or is
            stopped for safety.
    """
    scale = scale_of(ur)
    reader, found = RestReader(scale), asyncio.Queue[Rest | RtdeError]()
    newest: list[Package] = []

    def take(values: tuple[Decoded, ...], arrival_s: float) -> None:
        newest[:] = [Package.of(values)]
        if (rest := reader.feed(newest[0])) is not None:
            found.put_nowait(rest)

    client = RtdeClient(
        ur.host,
        ur.rtde_port,
        clock=asyncio.get_running_loop().time,
        on_package=take,
        on_lost=found.put_nowait,
        timeout_s=ur.connect_s,
    )
    rests: tuple[Rest, ...] = ()
    try:
        await client.connect()
        await client.setup(OUTPUTS, RATE_HZ)
        await client.start()
        await _check(client, ur, newest[0])
        while True:
            rest = await found.get()
            if isinstance(rest, RtdeError):
                raise rest
            if rests and (turned_rad := Weighing(scale, rests).turned_rad(rest.down)) < MIN_TURN_RAD:
                on_near(turned_rad)
                continue
            rests = (*rests, rest)
            yield Weighing(scale, rests)
    except RtdeError as error:
        raise DriverError(LINK_FAULTS.get(error.reason, FaultCode.PROTOCOL), str(error)) from error
    finally:
        await client.close()


async def _check(client: RtdeClient, ur: UrSection, package: Package) -> None:
    version = client.controller_version
    number = (0, 0, 0) if version is None else (version.major, version.minor, version.bugfix)
    facts = replace(await gate.ask_dashboard(number, ur), package=package)
    failed = [check.text for check in gate.failures(gate.judge_arm(facts, ur)) if check.name in CHECKED]
    if failed:
        raise DriverError(FaultCode.AUTHORITY, "; ".join(failed))
