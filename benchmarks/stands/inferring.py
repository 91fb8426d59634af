"""A policy that computes without a pause, in a process and with the priority as a cell's control process runs it.

Run `python -m benchmarks.stands.inferring MODEL`.
"""

import sys
from pathlib import Path

import numpy as np

from benchmarks.harness.processes import READY
from service.cell.policy_process import PolicyProcess
from wire.arrays import Float32Array

PATIENCE_S = 1.0


def main(model: Path) -> None:
    policy = PolicyProcess(model, step_limit_s=PATIENCE_S, patience_s=PATIENCE_S, realtime=True)
    _, contract = policy.loaded()
    observation = np.zeros(contract.observation_size, np.float32)
    inference = policy.infer(_discard, _fail)
    print(READY, flush=True)
    while True:
        inference.ask(observation)


def _discard(_: Float32Array) -> None: ...


def _fail(error: Exception) -> None:
    raise SystemExit(str(error))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
