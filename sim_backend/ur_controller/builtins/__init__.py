"""Functions of URScript, by theme; `standard_builtins` collects those that a script can call."""

from sim_backend.ur_controller.builtins.io import io_builtins
from sim_backend.ur_controller.builtins.kinematics import kinematics_builtins
from sim_backend.ur_controller.builtins.mathematics import MATHEMATICS
from sim_backend.ur_controller.builtins.motion import motion_builtins
from sim_backend.ur_controller.builtins.poses import POSES
from sim_backend.ur_controller.builtins.registers import register_builtins
from sim_backend.ur_controller.builtins.sockets import socket_builtins
from sim_backend.ur_controller.builtins.state import state_builtins
from sim_backend.ur_controller.builtins.strings import STRINGS
from sim_backend.ur_controller.controller import Controller
from sim_backend.ur_controller.script import Builtin


def standard_builtins(controller: Controller) -> dict[str, Builtin]:
    """Return every builtin that is not part of the language itself, bound to `controller`."""
    return {
        **MATHEMATICS,
        **STRINGS,
        **POSES,
        **state_builtins(controller),
        **register_builtins(controller),
        **io_builtins(controller.terminals),
        **socket_builtins(controller.sockets),
        **motion_builtins(controller),
        **kinematics_builtins(controller),
    }
