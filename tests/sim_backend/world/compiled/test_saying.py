"""Which implementation computes the ticks is said by the command and by a simulator as it starts."""

import subprocess
import sys

import pytest

from sim_backend.world import compiled

WITHOUT = "import sys; sys.modules['sim_backend.world.compiled._tick'] = None; "
PROGRAM = "from cli.__main__ import app; app(sys.argv[1:])"


def run(*arguments: str, built: bool = True) -> subprocess.CompletedProcess[str]:
    program = [sys.executable, "-c", ("import sys; " if built else WITHOUT) + PROGRAM, *arguments]
    return subprocess.run(program, capture_output=True, text=True, timeout=100)


def test_the_version_says_it_with_and_without_the_extension() -> None:
    assert run("--version").stdout.splitlines()[2] == compiled.describe()
    assert "numpy, slower; the compiled tick is not used, it is not built" in run("--version", built=False).stdout


@pytest.mark.parametrize("simulator", [("serve", "--mode", "lockstep"), ("ur-controller", "--any-ports")])
def test_a_simulator_without_the_extension_says_so_as_it_starts(simulator: tuple[str, ...], free_endpoint: str) -> None:
    program = [sys.executable, "-c", WITHOUT + PROGRAM, "sim", *simulator, "--listen", free_endpoint]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("ready")
        process.terminate()
        errors = process.communicate(timeout=30)[1]
    assert "simulated ticks: numpy, slower" in errors
