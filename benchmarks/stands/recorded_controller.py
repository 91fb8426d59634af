"""The emulated controller's command with one addition: it records the motion and the forces of its arm.

Run `python -m benchmarks.stands.recorded_controller OUTPUT OPTION…` with the options of `dsl-assembly sim
ur-controller`. It prints `contact` whenever the peg begins to press, and writes one row per tick to OUTPUT (`.npy`) at
the end: monotonic time in s, inputs received, program running, speed of the TCP in m/s, true force on the peg in N.
"""

import functools
import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.stands.pressed_arm import ContactForce
from sim_backend import commands
from sim_backend.ur_controller import assembly
from sim_backend.ur_controller.builtins import standard_builtins
from sim_backend.ur_controller.controller import Controller
from wire.rtde.modes import RuntimeState

CONTACT = "contact"
PRESSING_N, FREE_N = 3.0, 0.5


class RecordedController(Controller):
    """Adds a row per tick to `rows`."""

    rows: list[tuple[float, ...]] = []  # noqa: RUF012  # rows of the only controller of this process

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._fed = self._pressing = False
        self._contact = ContactForce(self.plant)
        self.plant.on_placed.append(self._look_again)

    def apply_inputs(self, names: Sequence[str], values: Sequence[Any]) -> None:
        self._fed = True
        super().apply_inputs(names, values)

    def tick(self) -> None:
        super().tick()
        force_n = self._contact()
        running = self.runtime_state is RuntimeState.PLAYING
        speed_m_s = math.hypot(*self.plant.tcp_speed()[:3])
        self.rows.append((time.monotonic(), self._fed, running, speed_m_s, force_n))
        self._fed = False
        if force_n > PRESSING_N and not self._pressing:
            self._pressing = True
            print(CONTACT, flush=True)
        elif force_n < FREE_N:
            self._pressing = False

    def _look_again(self) -> None:
        self._contact = ContactForce(self.plant)


def main(output: Path, options: Sequence[str]) -> None:
    assembly.make_controller = functools.partial(RecordedController, make_builtins=standard_builtins)
    try:
        commands.app([*options])
    finally:
        np.save(output, np.array(RecordedController.rows))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
