"""A Universal Robots controller."""

from typing import Annotated, Literal

from pydantic import Field

from service.config.fields import Finite, Port, Position, Positive, Section


class UrSection(Section):
    """A Universal Robots e-Series controller; `docs/how-to/commission-a-ur.md` explains how to find each number.

    Attributes:
        host: address of the controller.
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

    host: str
    rtde_port: Port = 30004
    dashboard_port: Port = 29999
    primary_port: Port = 30001
    gripper_port: Port = 63352
    model: Annotated[str, Field(pattern=r"^UR\d+\w*$")] | None = None
    serial: Annotated[str, Field(pattern=r"^\d+$")] | None = None
    simulated: bool = False
    payload_kg: Annotated[float, Field(ge=0.0, le=50.0, allow_inf_nan=False)]
    payload_com_m: Position
    tcp_m: tuple[Finite, Finite, Finite, Finite, Finite, Finite]
    torque_about: Literal["flange", "tcp"] = "flange"
    force_range_n: Positive = 30.0
    torque_range_nm: Positive = 10.0
    watchdog_hz: Annotated[float, Field(ge=2.0, le=50.0, allow_inf_nan=False)] = 10.0
    stop_retract_m: Annotated[float, Field(ge=0.0, le=0.02, allow_inf_nan=False)] = 0.0
    prove_watchdog: bool | None = None
    connect_s: Annotated[float, Field(ge=0.5, le=30.0, allow_inf_nan=False)] = 3.0
