"""A Universal Robots controller, and what the arms of its series can do."""

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from service.config.fields import Host, Offset, Port, Section, Turn, number

ArmModel = Literal["UR3e", "UR5e", "UR10e", "UR16e"]


@dataclass(frozen=True, slots=True)
class Rating:
    """Ratings of an arm, from the manufacturer's data sheets.

    Attributes:
        payload_kg: largest payload.
        reach_m: radius of the working space about the base.
        force_range_n: end of the sensor's range, per channel of force.
        torque_range_nm: end of the sensor's range, per channel of torque.
    """

    payload_kg: float
    reach_m: float
    force_range_n: float
    torque_range_nm: float


RATINGS: dict[ArmModel, Rating] = {
    "UR3e": Rating(3.0, 0.5, 30.0, 10.0),
    "UR5e": Rating(5.0, 0.85, 50.0, 10.0),
    "UR10e": Rating(12.5, 1.3, 100.0, 10.0),
    "UR16e": Rating(16.0, 0.9, 160.0, 10.0),
}

Centre = tuple[Offset, Offset, Offset]
TcpPose = tuple[Offset, Offset, Offset, Turn, Turn, Turn]


class UrSection(Section):
    """A Universal Robots e-Series controller; `docs/how-to/commission-a-ur.md` explains how to find each number.

    Attributes:
        host: address of the controller.
        arm: model of the arm; payload, start poses and the sensor's range are checked against its ratings.
        rtde_port: port of its real-time data exchange.
        dashboard_port: port of its dashboard server.
        primary_port: port of its primary interface, which takes the control program.
        gripper_port: port of the URCap of a Robotiq gripper, for `dsl-assembly ur gripper`.
        model: model that must answer, as the dashboard names it: UR3 for a UR3e; None: any.
        serial: serial number that must answer; None: any.
        simulated: whether it is the emulated controller of this project, whose world is laid out from a seed; `sim`
            then names that world.
        payload_kg: mass of everything that the flange carries.
        payload_com_m: centre of that mass, flange axes.
        tcp_m: pose of the TCP in the flange's frame: m, and a rotation vector in rad.
        torque_about: point to which the controller's torque refers; on the e-Series, the flange.
        force_range_n: end of the sensor's range, per channel of force.
        torque_range_nm: the same for torque.
        watchdog_hz: the control program ends when fewer packages per second than this come from the host.
        stop_retract_m: height by which the arm moves up after a stop by force; 0: it does not.
        prove_watchdog: whether each start lets the watchdog trip once; None: only where the controller is simulated.
        connect_s: longest time that the controller may take for one answer.
    """

    host: Host
    arm: ArmModel = "UR3e"
    rtde_port: Port = 30004
    dashboard_port: Port = 29999
    primary_port: Port = 30001
    gripper_port: Port = 63352
    model: Annotated[str, Field(pattern=r"^UR\d+\w*$")] | None = None
    serial: Annotated[str, Field(pattern=r"^\d+$")] | None = None
    simulated: bool = False
    payload_kg: Annotated[float, number(0.0, 16.0, "a bare flange; the strongest arm of the series")]
    payload_com_m: Centre
    tcp_m: TcpPose
    torque_about: Literal["flange", "tcp"] = "flange"
    force_range_n: Annotated[float, number(5.0, 160.0, "a contact saturates it; the strongest sensor")] = 30.0
    torque_range_nm: Annotated[float, number(0.5, 10.0, "a contact saturates it; every sensor of the series")] = 10.0
    watchdog_hz: Annotated[float, number(2.0, 50.0, "half a second without a host; a host's own jitter")] = 10.0
    stop_retract_m: Annotated[float, number(0.0, 0.02, "no retract; longer than a stop lasts")] = 0.0
    prove_watchdog: bool | None = None
    connect_s: Annotated[float, number(0.5, 30.0, "a controller answers in 0.1 s; a start that hangs")] = 3.0
