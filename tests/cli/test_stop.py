import re
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from service.faults import FaultCode
from service.program import command
from tests.api.wire_cell import WireCell, free_port, write_config
from tests.cli.serving import run, served, wait_for_state


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


def name_a_port(config_path: Path, port: int) -> str:
    """Write the API's port into a configuration and return the API's address."""
    config_path.write_text(config_path.read_text().replace("[api]", f"[api]\nport = {port}"))
    return f"http://127.0.0.1:{port}"


def test_the_configured_cell_is_stopped_past_its_own_api(
    config_path: Path, cell: WireCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = name_a_port(config_path, free_port())
    monkeypatch.chdir(config_path.parent)
    done = run("stop")
    assert done.exit_code == 0, done.output
    assert done.stdout.startswith("cell cell-test: ")
    assert run("stop", "--url", own).exit_code == 0
    assert cell.stops == ["stop past the API"] * 2


@pytest.mark.parametrize("url", ["http://127.0.0.1:{}", "127.0.0.1:{}", "nonsense"])
def test_an_address_that_reaches_nobody_holds_no_stop_of_the_configured_cell_up(
    config_path: Path, cell: WireCell, monkeypatch: pytest.MonkeyPatch, url: str
) -> None:
    monkeypatch.setenv("DSL_ASSEMBLY_URL", url.format(free_port()))
    named = run("stop", "--config", str(config_path))
    assert named.exit_code == 0, named.output
    monkeypatch.chdir(config_path.parent)
    done = run("stop")
    assert done.exit_code == 6, "the address may be that of another cell"
    assert "if " + url.format("")[:9] in done.stderr
    assert cell.stops == ["stop past the API"] * 2


def test_an_address_that_is_none_reaches_nobody_where_no_cell_is_configured() -> None:
    done = run("stop", "--url", "127.0.0.1:8000")
    assert done.exit_code == 4
    assert "http://127.0.0.1:8000" in done.stderr


@pytest.fixture
def other(tmp_path: Path) -> Iterator[tuple[Path, WireCell, str]]:
    """Configuration, control process and API of a second cell."""
    folder = tmp_path / "other"
    folder.mkdir()
    port = free_port()
    path = write_config(folder, port, cell="cell-other")
    address = name_a_port(path, free_port())
    with WireCell(f"tcp/127.0.0.1:{port}", id="cell-other") as cell, served(path, int(address.rpartition(":")[2])):
        wait_for_state(address, "READY")
        yield path, cell, address


def test_of_two_cells_the_configured_one_is_started_and_stopped(
    url: str, cell: WireCell, other: tuple[Path, WireCell, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, second, address = other
    monkeypatch.setattr("cli.connection.DEFAULT_URL", url)
    monkeypatch.setattr("cli.stop.DEFAULT_URL", url)
    for folder, variable in ((path.parent, ""), (Path("/"), str(path))):
        monkeypatch.chdir(folder)
        monkeypatch.setenv("DSL_ASSEMBLY_CONFIG", variable)
        assert "cell cell-other: accepted" in run("start").stdout
        done = run("stop")
        assert done.exit_code == 0, done.output
        assert done.stdout.startswith("cell cell-other: LATCHED")
        assert "cell-other" in run("status").stdout
        wait_for_state(address, "LATCHED")
        assert run("reset", "--operator", "M. Sato").stdout.startswith("cell cell-other: OPERATOR_STOP")
        wait_for_state(address, "READY")
    monkeypatch.delenv("DSL_ASSEMBLY_CONFIG")
    assert run("stop", "--config", str(path)).exit_code == 0
    assert second.stops == ["stop over HTTP"] * 3
    assert not cell.stops
    assert not cell.runs


@pytest.mark.parametrize("arguments", [["start"], ["status"], ["reset", "--operator", "M. Sato"], ["runs"], ["watch"]])
def test_an_api_of_another_cell_than_the_named_one_is_refused(
    url: str, cell: WireCell, other: tuple[Path, WireCell, str], arguments: list[str]
) -> None:
    done = run(*arguments, "--url", url, "--config", str(other[0]))
    assert done.exit_code == 4
    assert "serves cell cell-test, not the configured cell cell-other" in done.stderr
    assert not cell.runs


def test_a_stop_that_another_cell_took_goes_to_the_configured_one_as_well(
    url: str, cell: WireCell, other: tuple[Path, WireCell, str]
) -> None:
    path, second, _ = other
    done = run("stop", "--url", url, "--config", str(path))
    assert done.exit_code == 0, done.output
    assert [line.partition(":")[0] for line in done.stdout.splitlines()] == ["cell cell-test", "cell cell-other"]
    assert (cell.stops, second.stops) == (["stop over HTTP"], ["stop past the API"])


def test_a_stop_that_another_cell_took_is_none_of_the_configured_one(
    url: str, cell: WireCell, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = write_config(tmp_path_factory.mktemp("away"), free_port(), cell="cell-away")
    done = run("stop", "--url", url, "--config", str(path))
    assert done.exit_code == 4
    assert done.stdout.startswith("cell cell-test: ")
    assert "not delivered to cell cell-away" in done.stderr
    assert cell.stops == ["stop over HTTP"]


def test_a_configuration_that_cannot_be_read_confirms_no_stop(url: str, cell: WireCell, tmp_path: Path) -> None:
    done = run("stop", "--url", url, "--config", str(tmp_path / "away.toml"))
    assert done.exit_code == 4
    assert "away.toml cannot be read" in done.stderr
    assert cell.stops == ["stop over HTTP"], "a stop too many is the safe error"


def test_a_configuration_with_a_wrong_limit_still_names_the_cell_to_stop(config_path: Path, cell: WireCell) -> None:
    config_path.write_text(config_path.read_text().replace("force_ceiling_n = 30.0", "force_ceiling_n = 300.0"))
    assert run("stop", "--config", str(config_path)).exit_code == 0
    assert cell.stops == ["stop past the API"]


def test_a_frozen_control_process_is_said_in_time(config_path: Path) -> None:
    with frozen_api() as port:
        config_path.write_text(re.sub(r"(endpoint = .*:)\d+", rf"\g<1>{port}", config_path.read_text()))
        began = time.monotonic()
        done = subprocess.run(
            command("stop", "--config", str(config_path)), capture_output=True, text=True, timeout=60, check=False
        )
        assert time.monotonic() - began < 9.0
    assert done.returncode == 4
    assert "delivered to nobody: the API was not reached" in done.stderr
    assert "the control process" in done.stderr
    assert ".." not in done.stderr


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
