"""A plain loop of ur_rtde and ONNX Runtime, as a user without this project writes it.

Run `python -m benchmarks.stands.ur_rtde_policy HOST MODEL SECONDS OUTPUT`. Every 2 ms it takes the newest package,
compares the force with a ceiling, and every 100 ms runs the model and sends the arm to where it is. At the end it
writes two tables to OUTPUT (`.npz`), in s, as `watched_service` does: `judged` and `steps`, without the arrivals.
"""

import importlib
import math
import sys
import time
from collections import deque
from pathlib import Path

import numpy as np
import onnxruntime

from benchmarks.harness.processes import READY
from benchmarks.stands.rtde_connection import RATE_HZ
from wire.limits import FORCE_CEILING_N
from wire.realtime import request_realtime, settle_interpreter
from wire.records import TICK_S

STEP_TICKS = 50
LOOKAHEAD_S, GAIN = 0.1, 300.0


def main(host: str, model: Path, seconds: float, output: Path) -> None:
    receive = importlib.import_module("rtde_receive").RTDEReceiveInterface(host, RATE_HZ)
    control = importlib.import_module("rtde_control").RTDEControlInterface(host, RATE_HZ)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(model.read_bytes(), options, providers=["CPUExecutionProvider"])
    feed = {node.name: np.zeros((1, node.shape[1]), np.float32) for node in session.get_inputs()}
    settle_interpreter()
    request_realtime()
    window: deque[list[float]] = deque(maxlen=STEP_TICKS)
    judged: list[tuple[float, float]] = []
    steps: list[tuple[float, ...]] = []
    stamp = receive.getTimestamp()
    print(READY, flush=True)
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        period = control.initPeriod()
        newest = receive.getTimestamp()
        if newest != stamp:
            begin_s, stamp = time.monotonic(), newest
            force = receive.getActualTCPForce()
            if math.hypot(*force[:3]) >= FORCE_CEILING_N:
                raise SystemExit(f"{force} is above the ceiling")
            judged.append((stamp, time.monotonic()))
            window.append(force)
            if len(judged) % STEP_TICKS == 0:
                feed["observation"][0, :6] = np.mean(window, axis=0)
                session.run(None, feed)
                control.servoL(receive.getActualTCPPose(), 0.0, 0.0, TICK_S, LOOKAHEAD_S, GAIN)
                now_s = time.monotonic()
                steps.append((stamp, math.nan, now_s, now_s - begin_s))
        control.waitPeriod(period)
    np.savez(output, judged=np.array(judged), steps=np.array(steps))
    control.servoStop()
    control.stopScript()


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), float(sys.argv[3]), Path(sys.argv[4]))
