"""Assembly of the emulated controller: the controller and the script builtins that act on it."""

from sim_backend.ur_controller.builtins import standard_builtins
from sim_backend.ur_controller.controller import Controller
from sim_backend.ur_controller.plant import Plant
from sim_backend.ur_controller.safety import Durations


def make_controller(plant: Plant, *, durations: Durations | None = None) -> Controller:
    """Make a controller whose scripts may call every standard builtin.

    Args:
        plant: the arm, its tool and what they touch.
        durations: time that powering on and the like take; the default `Durations` unless given.
    """
    return Controller(plant, standard_builtins, durations=durations)
