"""The control process with one addition: it records how late its loop judges each sample.

Run `python -m benchmarks.stands.watched_service OUTPUT`; the environment gives the configuration. At the end it writes
the latenesses, in s, to OUTPUT (`.npy`).
"""

import sys
from pathlib import Path

import numpy as np

from service.cell.cell import Cell
from service.commands.control import control
from service.drivers.base import Sample


def main(output: Path) -> None:
    late_s: list[float] = []
    judge = Cell.on_sample

    def on_sample(self: Cell, sample: Sample) -> None:
        judge(self, sample)
        late_s.append(self.driver.clock() - sample.arrival_s)

    Cell.on_sample = on_sample
    try:
        control(None)
    finally:
        np.save(output, np.array(late_s))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
