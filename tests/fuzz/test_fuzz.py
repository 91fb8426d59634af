"""Fuzzing for as long as a test may take; `FUZZ_SECONDS=600` before pytest takes that long for each target."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

HANG_S = 10
"""Wall-clock time after which an input counts as a hang, s: so long that other work on the machine makes none."""
HERE = Path(__file__).parent
SECONDS = int(os.environ.get("FUZZ_SECONDS", "1"))

PLANTED = """
from fuzzing import fuzz

def check(data: bytes) -> None:
    if data[:1] == b"x":
        {fault}

fuzz(check, [b"x"])
"""


def run(program: Path, folder: Path, seconds: int, hang_s: int) -> subprocess.CompletedProcess[str]:
    # by way of a shell: a child inherits its parent's peak memory at exec, and libFuzzer takes that for its own
    return subprocess.run(
        ["/bin/sh", "-c", '"$@"; exit $?', "sh", sys.executable, str(program), str(folder), str(seconds), str(hang_s)],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": str(HERE)},
        timeout=seconds + 60,
    )


@pytest.mark.timeout(SECONDS + 90)
@pytest.mark.parametrize("target", ["rtde", "rtde_service", "primary", "urscript"])
def test_no_input_crashes_hangs_or_fills_the_memory(target: str, tmp_path: Path) -> None:
    result = run(HERE / f"{target}.py", tmp_path, SECONDS, HANG_S)
    assert result.returncode == 0, result.stderr[-3000:]
    done = re.search(r"Done (\d+) runs", result.stderr)
    assert done is not None, result.stderr[-3000:]
    covered = [int(number) for number in re.findall(r"cov: (\d+)", result.stderr)]
    assert covered[-1] > covered[0]  # it was guided
    assert int(done[1]) > 20


@pytest.mark.parametrize(
    ("fault", "told"),
    [("data[5000]", "IndexError"), ("while True: pass", "timeout"), ("bytearray(1 << 30)[::4096]", "out-of-memory")],
)
def test_a_fault_that_was_planted_is_found(fault: str, told: str, tmp_path: Path) -> None:
    program = tmp_path / "planted.py"
    program.write_text(PLANTED.format(fault=fault))
    result = run(program, tmp_path, 20, 1)
    assert result.returncode != 0
    assert told in result.stderr + result.stdout
