"""CPU time of other processes."""

import time


def cpu_s(pid: int) -> float:
    """Return the CPU seconds of all threads of a process of this machine; to the nanosecond, unlike `/proc`.

    Raises:
        OSError: there is no such process.
    """
    return time.clock_gettime(~pid << 3 | 2)  # Linux' clock of a process: clock_getcpuclockid(3)
