"""A process that asked for real-time scheduling and locked memory, as its host treats it."""

import subprocess
import sys

import pytest

LOCKED = """
import mmap
from pathlib import Path
from wire.realtime import request_realtime

def kib(name):
    return int(Path("/proc/self/status").read_text().split(f"{name}:")[1].split()[0])

refused = request_realtime()
before = kib("VmRSS")
memory = mmap.mmap(-1, 64 << 20)
unused = kib("VmRSS") - before
memory[: 16 << 20] = bytes(16 << 20)
print(*refused, sep="\\n")
print(unused, kib("VmRSS") - before, kib("VmLck"))
"""


def test_locked_memory_is_what_the_process_uses() -> None:
    said = subprocess.run([sys.executable, "-c", LOCKED], check=True, capture_output=True, text=True).stdout
    if "no locked memory" in said:
        pytest.skip(said)
    unused, used, locked = (int(number) for number in said.splitlines()[-1].split())
    assert unused < 1 << 10, "KiB, of 64 MiB that nothing was written to"
    assert used >= 16 << 10
    assert locked >= 64 << 10, "the kernel keeps in memory what is used from now on"
