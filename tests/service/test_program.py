import signal
import subprocess
import sys
import time
from pathlib import Path

from service.program import Child


def is_gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except FileNotFoundError:
        return True


def test_a_child_that_has_ended_gives_its_status_and_its_last_line(tmp_path: Path) -> None:
    child = Child.start("clerk", ("no-such-command",), tmp_path / "logs" / "clerk.log")
    child.process.wait(60)
    ending = child.ending()
    assert ending is not None
    assert ending.startswith(f"the clerk (pid {child.process.pid}) ended with status 2: ")


def test_a_child_that_was_killed_gives_no_line_for_a_reason(tmp_path: Path) -> None:
    child = Child.start("clerk", ("--version",), tmp_path / "clerk.log")
    child.process.kill()
    child.process.wait(60)
    child.log.write_text("ready\n")
    assert child.ending() == f"the clerk (pid {child.process.pid}) ended with status -9"


def test_a_child_ends_when_it_is_asked_and_is_killed_when_it_does_not(tmp_path: Path) -> None:
    log = tmp_path / "log"
    for ignores, in_time in ((False, True), (True, False)):
        disposition = "signal.SIG_IGN" if ignores else "signal.SIG_DFL"
        program = (
            f"import signal, time; signal.signal(signal.SIGTERM, {disposition}); print(flush=True); time.sleep(60)"
        )
        process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
        assert process.stdout is not None
        process.stdout.readline()
        assert Child("sleeper", process, log).end(10.0 if in_time else 0.2) is in_time
        assert process.returncode == (-signal.SIGTERM if in_time else -signal.SIGKILL)
        process.stdout.close()


def test_a_bound_child_does_not_outlive_a_parent_that_is_killed(tmp_path: Path) -> None:
    program = f"""
import signal
from pathlib import Path
from service.program import Child
world = ("sim", "ur-controller", "--host", "127.0.0.77", "--any-ports")
child = Child.start("world", world, Path({str(tmp_path / "log")!r}), ends_with_parent=signal.SIGKILL)
print(child.process.pid, flush=True)
child.process.wait()
"""
    parent = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    assert not is_gone(pid)
    parent.send_signal(signal.SIGKILL)
    parent.communicate()
    deadline = time.monotonic() + 10
    while not is_gone(pid):
        assert time.monotonic() < deadline
        time.sleep(0.02)
