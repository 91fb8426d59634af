"""Bare calls of ONNX Runtime on one model, scheduled as a policy's process: `… bare_inference MODEL HOT RESTED`.

It prints the durations as JSON, s: `hot`, one call after the other, and `rested`, each after 100 ms without a call.
"""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnxruntime

from benchmarks.harness.exchange import spans
from service.policy.model import session_options
from wire.realtime import request_prompt_answers

REST_S = 0.1
LONGEST_S = 30.0


def bare_call(model: Path) -> Callable[[], object]:
    """Return one call on zeros, with the session's settings of a policy and none of its checks."""
    session = onnxruntime.InferenceSession(model.read_bytes(), session_options(), providers=["CPUExecutionProvider"])
    feed = {node.name: np.zeros((1, node.shape[1]), np.float32) for node in session.get_inputs()}
    return lambda: session.run(None, feed)


def main(model: Path, hot: int, rested: int) -> None:
    call = bare_call(model)
    request_prompt_answers(LONGEST_S)
    taken = spans(hot, call)
    after_rest: list[float] = []
    for _ in range(rested):
        time.sleep(REST_S)
        begin = time.perf_counter()
        call()
        after_rest.append(time.perf_counter() - begin)
    print(json.dumps({"hot": taken, "rested": after_rest}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
