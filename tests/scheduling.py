"""Scheduling of other processes, as the kernel tells it."""

import os
from pathlib import Path

ORDINARY = (os.SCHED_OTHER, 0)


def schedulings(pid: int) -> set[tuple[int, int]]:
    """Policy and priority of every thread of a process."""
    threads = [int(task.name) for task in Path(f"/proc/{pid}/task").iterdir()]
    return {(os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority) for thread in threads}


def children(pid: int) -> dict[int, str]:
    """Command lines of the processes that a process has started, by their ids."""
    found = Path(f"/proc/{pid}/task").glob("*/children")
    pids = [int(child) for file in found for child in file.read_text().split()]
    return {child: Path(f"/proc/{child}/cmdline").read_bytes().replace(b"\0", b" ").decode() for child in pids}
