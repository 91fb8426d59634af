"""The emulated controller's command with one addition: it records the lateness and duration of its ticks.

Run `python -m benchmarks.stands.watched_controller OUTPUT OPTION…` with the options of `dsl-assembly sim
ur-controller`. At the end it writes one row per tick to OUTPUT (`.npy`), in s: monotonic time of its begin, lateness of
its beat, duration. A program sent by ur_rtde runs again, as a secondary one, beside a later main program.
"""

import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.harness.stopwatch import timed
from sim_backend import commands as command
from sim_backend.metronome import Metronome
from sim_backend.ur_controller import server
from sim_backend.ur_controller.controller import Controller
from sim_backend.ur_controller.server import ControllerServer

_UR_RTDE = "def rtde_control("


def main(output: Path, options: Sequence[str]) -> None:
    late_s: list[float] = []

    class WatchedMetronome(Metronome):
        def wait(self, beats: int = 1) -> None:
            due_s = self._due_s + beats * self._period_s
            super().wait(beats)
            late_s.append(time.monotonic() - due_s)

    run_script = Controller.run_script
    kept: list[str] = []

    def run_beside(self: Controller, text: str) -> None:
        run_script(self, text)
        if text.startswith(_UR_RTDE):
            kept[:] = [text.replace("def", "sec", 1)]
        elif kept:
            run_script(self, kept[0])

    server.Metronome = WatchedMetronome
    Controller.run_script = run_beside
    with timed(ControllerServer, "step") as steps:
        try:
            command.app(["ur-controller", *options])
        finally:
            begins = np.array([begin for begin, _ in steps.calls])
            count = len(begins)
            np.save(output, np.stack([begins, late_s[:count], steps.spans_s], axis=1))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
