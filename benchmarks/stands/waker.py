"""Lateness of the host's timer: sleeps until each beat of 2 ms and computes nothing, as cyclictest does.

Run `python -m benchmarks.stands.waker OUTPUT [ordinary]`. `ordinary` omits the request for real-time scheduling. At
SIGTERM it writes the latenesses, in s, to OUTPUT (`.npy`).
"""

import ctypes
import signal
import sys
import time
from pathlib import Path
from types import FrameType

import numpy as np

from benchmarks.harness.processes import READY
from wire.realtime import request_realtime, settle_interpreter
from wire.records import TICK_S

_TIMER_ABSTIME = 1
_BEAT_NS = round(TICK_S * 1e9)


class _Timespec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


def main(output: Path, *, ordinary: bool) -> None:
    settle_interpreter()
    if not ordinary:
        request_realtime()
    sleep_until = ctypes.CDLL(None).clock_nanosleep
    until, late_ns, ended = _Timespec(), list[int](), False

    def end(_number: int, _frame: FrameType | None) -> None:
        nonlocal ended
        ended = True

    signal.signal(signal.SIGTERM, end)
    print(READY, flush=True)
    due_ns = time.monotonic_ns() + _BEAT_NS
    while not ended:
        until.seconds, until.nanoseconds = divmod(due_ns, 10**9)
        sleep_until(time.CLOCK_MONOTONIC, _TIMER_ABSTIME, ctypes.byref(until), None)
        late_ns.append(time.monotonic_ns() - due_ns)
        due_ns += _BEAT_NS
    np.save(output, np.array(late_ns[:-1]) * 1e-9)  # the signal cut the last sleep short


if __name__ == "__main__":
    main(Path(sys.argv[1]), ordinary="ordinary" in sys.argv[2:])
