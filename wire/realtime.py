"""Real-time request of a 500 Hz process to its host."""

import contextlib
import ctypes
import gc
import os
import resource
import sys
import threading

PRIORITY = 40
"""Priority of the control process under SCHED_FIFO: below the kernel's own threads (50)."""
SIMULATOR_PRIORITY = 30
"""Priority of a simulator: below the control process that it serves."""
POLICY_PRIORITY = 20
"""Priority of a policy's process: below the loop that waits for its answer, above all ordinary programs."""
SWITCH_INTERVAL_S = 1e-4
"""Longest time for which one Python thread may hold up another, s; Python's default is 5 ms. It is part of a stop: the
transport's thread judges a sample while the loop computes."""
_MCL_CURRENT_AND_FUTURE = 3
_MCL_ONFAULT = 4


def request_realtime(priority: int = PRIORITY) -> tuple[str, ...]:
    """Ask for real-time scheduling of this thread and Python's other ones, and for locked memory.

    Memory is locked as it is used, so that unused parts of stacks and libraries take none. A kernel before 4.4 locks
    everything at once.

    The other threads of Python have it too, lest one of ordinary priority be held up by other programs while it holds
    the interpreter's lock. Threads started afterwards inherit it; those started before by libraries stay as they are.

    Args:
        priority: under SCHED_FIFO.

    Returns:
        One line for each refusal, with its remedy; empty if everything was granted.
    """
    refused: list[str] = []
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        for thread in threading.enumerate():
            with contextlib.suppress(ProcessLookupError):  # it has just ended
                os.sched_setscheduler(thread.native_id or 0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        refused.append(
            f"no real-time scheduling ({error.strerror}): a tick may be some milliseconds late; "
            "raise the rtprio limit of this user, or grant CAP_SYS_NICE to the process"
        )
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT_AND_FUTURE | _MCL_ONFAULT) and libc.mlockall(_MCL_CURRENT_AND_FUTURE):
        reason = os.strerror(ctypes.get_errno())
        refused.append(
            f"no locked memory ({reason}): a page fault may delay a tick; raise the memlock limit of this user"
            ", or grant CAP_IPC_LOCK to the process"
        )
    return tuple(refused)


def request_prompt_answers(limit_s: float) -> None:
    """Ask for real-time scheduling of this thread below `PRIORITY`. A refusal changes nothing.

    Args:
        limit_s: processor time without a pause after which the kernel kills the process, so that a computation without
            an end takes no core from the rest of the host, s.
    """
    limit_us = round(limit_s * 1e6)
    resource.setrlimit(resource.RLIMIT_RTTIME, (limit_us, limit_us))
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(POLICY_PRIORITY))


def settle_interpreter() -> None:
    """Keep Python's own pauses shorter than a tick, with or without real-time scheduling.

    All present objects are exempt from garbage collection: one pass over a loaded program lasts longer than a tick.
    """
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    gc.collect()
    gc.freeze()
