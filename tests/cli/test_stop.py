import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from service.faults import FaultCode
from tests.api.wire_cell import WireCell, free_port
from tests.cli.serving import run, wait_for_state


def test_a_stop_ends_when_the_arm_is_measured_standing(url: str, cell: WireCell) -> None:
    assert run("start", "--url", url).exit_code == 0
    done = run("stop", "--url", url)
    assert done.exit_code == 0, done.output
    assert "standstill is measured" in done.stdout
    assert cell.stops[0] == "stop over HTTP"
    assert cell.latch is not None
    assert cell.latch.code is FaultCode.OPERATOR_STOP
    assert run("stop", "--url", url).exit_code == 0, "any number of times, in every state"


def test_a_stop_that_is_not_seen_to_end_the_motion_says_so(url: str, cell: WireCell) -> None:
    cell.arm_stops = False
    assert run("start", "--url", url).exit_code == 0
    done = run("stop", "--url", url)
    assert done.exit_code == 6
    assert "standstill is not measured" in done.stdout


@contextmanager
def frozen_api() -> Iterator[int]:
    """A port that accepts connections and never answers."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        yield listener.getsockname()[1]


def test_without_an_api_the_stop_goes_to_the_control_process_itself(config_path: Path, cell: WireCell) -> None:
    done = run("stop", "--url", f"http://127.0.0.1:{free_port()}", "--config", str(config_path))
    assert done.exit_code == 0, done.output
    assert cell.stops == ["stop past the API"]


def test_a_frozen_api_holds_no_stop_up(config_path: Path, cell: WireCell) -> None:
    with frozen_api() as port:
        began = time.monotonic()
        done = run("stop", "--url", f"http://127.0.0.1:{port}", "--config", str(config_path))
        assert time.monotonic() - began < 8.0
    assert done.exit_code == 0, done.output
    assert cell.stops == ["stop past the API"]


def test_the_configured_cell_is_stopped_past_its_own_api_and_no_other(
    config_path: Path, cell: WireCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = free_port()
    config_path.write_text(config_path.read_text().replace("[api]", f"[api]\nport = {port}"))
    monkeypatch.chdir(config_path.parent)
    other = run("stop", "--url", f"http://127.0.0.1:{free_port()}")
    assert other.exit_code == 4
    assert "--config" in other.stderr
    assert not cell.stops
    assert run("stop", "--url", f"http://127.0.0.1:{port}").exit_code == 0
    assert cell.stops == ["stop past the API"]


def test_a_stop_that_reaches_nobody_says_so_and_names_the_robots_own(
    config_path: Path, cell_port: int, tmp_path: Path
) -> None:
    done = run("stop", "--url", f"http://127.0.0.1:{free_port()}", "--config", str(config_path))
    assert done.exit_code == 4
    assert "delivered to nobody: the API was not reached" in done.stderr
    assert "the control process was not reached" in done.stderr
    assert "the robot's own emergency stop" in done.stderr


def test_a_stop_is_delivered_while_a_start_waits_for_its_answer(url: str, cell: WireCell) -> None:
    cell.hold_starts = True
    starting = threading.Thread(target=run, args=("start", "--url", url), daemon=True)
    starting.start()
    while not cell.held:
        time.sleep(0.01)
    assert run("stop", "--url", url).exit_code == 0
    cell.release()
    starting.join(30)
    wait_for_state(url, "READY")
