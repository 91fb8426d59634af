"""CPU time of other processes."""

import time


def cpu_s(pid: int) -> float:
    """CPU seconds that all threads of a process of this machine have taken; to the nanosecond, unlike `/proc`.

    Raises:
        OSError: there is no such process.
    """
    return time.clock_gettime(~pid << 3 | 2)  # Linux' clock of a process: clock_getcpuclockid(3)
