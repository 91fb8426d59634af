"""What the control process asks of the host so that its loop comes in time; what is refused is said."""

import ctypes
import gc
import os
import sys

PRIORITY = 40
"""Of SCHED_FIFO: below the kernel's own threads (50)."""
SWITCH_INTERVAL_S = 5e-4
_MCL_CURRENT_AND_FUTURE = 3


def request_realtime() -> tuple[str, ...]:
    """Ask for real-time scheduling and locked memory for this process; freeze what the garbage collector knows.

    Returns:
        One line for each thing refused, with its remedy; empty where everything was granted.
    """
    refused: list[str] = []
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    gc.collect()
    gc.freeze()
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError as error:
        refused.append(
            f"no real-time scheduling ({error.strerror}): the control loop may be some milliseconds late; "
            "grant CAP_SYS_NICE or an rtprio limit"
        )
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT_AND_FUTURE):
        reason = os.strerror(ctypes.get_errno())
        refused.append(
            f"no locked memory ({reason}): a page fault may delay the control loop; "
            "grant CAP_IPC_LOCK or a memlock limit"
        )
    return tuple(refused)
