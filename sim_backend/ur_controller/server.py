"""The emulated controller on the network: its ports and its 2 ms tick, on one thread."""

from dataclasses import dataclass, fields
from typing import Protocol

from sim_backend.metronome import Metronome
from sim_backend.ur_controller.controller import Controller
from sim_backend.ur_controller.dashboard_server import DashboardService
from sim_backend.ur_controller.gripper_server import Gripper, GripperService
from sim_backend.ur_controller.listener import Listener, Service
from sim_backend.ur_controller.outputs import Outputs
from sim_backend.ur_controller.primary_server import PrimaryService
from sim_backend.ur_controller.rtde_server import RtdeService
from wire.primary import packages, realtime
from wire.realtime import settle_interpreter
from wire.records import TICK_S
from wire.rtde import messages


@dataclass(frozen=True, slots=True)
class Ports:
    """TCP ports of an e-Series controller and of a gripper's URCap; 0 selects a free port."""

    rtde: int = messages.PORT
    dashboard: int = 29999
    primary: int = packages.PORT
    secondary: int = packages.SECONDARY_PORT
    realtime: int = realtime.PORT
    gripper: int = 63352


ANY_PORTS = Ports(*[0] * len(fields(Ports)))
"""Free ports only, for several controllers at one address."""


@dataclass(slots=True)
class Counters:
    """Counts of ticks and data packages since the start."""

    ticks: int = 0
    overruns: int = 0
    skipped: int = 0
    worst_lateness_s: float = 0.0
    rtde_sent: int = 0
    rtde_skipped: int = 0


class TickCompanion(Protocol):
    """Companion of the arm on the controller's thread, called once after every tick."""

    def step(self) -> bool:
        """Return True if the call took longer than a tick."""
        ...


class ControllerServer:
    """Serves one controller. Everything happens in the calling thread, in `step` or `run`.

    Attributes:
        ports: ports in use.
        counters: counts of ticks and packages; lateness only under `run`.
        gripper: gripper at the arm's tool.
    """

    def __init__(self, controller: Controller, host: str = "127.0.0.1", ports: Ports = Ports()) -> None:
        """Listen at every port.

        Args:
            controller: controller; from here on only `step` or `run` tick it.
            host: address of this machine to listen at.
            ports: requested ports.

        Raises:
            ListenError: listening at one port fails; none is open then.
        """
        self.counters = Counters()
        self.gripper = Gripper()
        self._controller = controller
        self._listener = Listener()
        outputs = Outputs(controller)
        self._rtde = RtdeService(controller, outputs)
        self._dashboard = DashboardService(controller)
        services: dict[str, Service] = {
            "rtde": self._rtde,
            "dashboard": self._dashboard,
            "primary": PrimaryService(controller, outputs, "primary"),
            "secondary": PrimaryService(controller, outputs, "secondary"),
            "realtime": PrimaryService(controller, outputs, "realtime"),
            "gripper": GripperService(self.gripper),
        }
        try:
            found = {
                name: self._listener.serve(service, host, getattr(ports, name)) for name, service in services.items()
            }
        except OSError:
            self._listener.close()
            raise
        self.ports = Ports(**found)

    def poll(self) -> None:
        """Handle the requests that have arrived; no time passes."""
        self._listener.poll()

    def step(self) -> None:
        """Run one tick: handle requests, advance the controller and its arm by 2 ms, publish to clients."""
        self._listener.poll()
        self._controller.tick()
        self._listener.publish()
        self.counters.ticks += 1

    def run(self, companion: TickCompanion | None = None) -> None:
        """Step every 2 ms by the wall clock, until an exception or until a client shuts the controller down.

        Args:
            companion: called after every tick.
        """
        settle_interpreter()
        metronome = Metronome(TICK_S)
        while not self._dashboard.shutdown_requested:
            metronome.wait()
            self.step()
            self._count(metronome)
            if companion is not None and companion.step():
                metronome.restart()

    def close(self) -> None:
        """End the controller's programs, disconnect every client and free the ports."""
        self._controller.close()
        self._listener.close()

    def _count(self, metronome: Metronome) -> None:
        counters = self.counters
        counters.overruns = metronome.overruns
        counters.skipped = metronome.skipped
        counters.worst_lateness_s = metronome.worst_lateness_s
        counters.rtde_sent, counters.rtde_skipped = self._rtde.sent, self._rtde.skipped
