import json
import threading
import time

import pytest

from service.faults import FaultCode
from service.messages import CellState, Problem, RefusalReason
from tests.api.wire_cell import RECIPE, WireCell, free_port
from tests.cli.serving import run, wait_for_state


def end_the_run(cell: WireCell, code: FaultCode | None) -> None:
    while cell.run is None:
        time.sleep(0.02)
    time.sleep(0.3)
    cell.succeed() if code is None else cell.fault(code)


def test_a_start_ends_with_the_acceptance_and_says_who_asked(url: str, cell: WireCell) -> None:
    done = run("start", RECIPE, "--seed", "7", "--operator", "M. Sato", "--url", url)
    assert done.exit_code == 0, done.output
    assert cell.runs[0].id in done.stdout
    assert (cell.runs[0].seed, cell.runs[0].requested_by) == (7, "M. Sato")
    again = run("start", "--url", url)
    assert again.exit_code == 5
    assert "WRONG_STATE" in again.stderr
    assert len(again.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize(("code", "status", "word"), [(None, 0, "SUCCEEDED"), (FaultCode.STALE, 1, "STALE")])
def test_a_start_that_waits_ends_with_the_outcome(
    url: str, cell: WireCell, code: FaultCode | None, status: int, word: str
) -> None:
    threading.Thread(target=end_the_run, args=(cell, code), daemon=True).start()
    done = run("start", "--wait", "--url", url)
    assert done.exit_code == status, done.output
    assert word in done.stdout


def test_a_start_as_json_is_the_run_and_nothing_else(url: str, cell: WireCell) -> None:
    threading.Thread(target=end_the_run, args=(cell, None), daemon=True).start()
    done = run("start", "--wait", "--json", "--url", url)
    assert json.loads(done.stdout)["state"] == "SUCCEEDED"


def test_an_unknown_recipe_is_refused_by_name(url: str, cell: WireCell) -> None:
    cell.refuse_start = Problem(reason=RefusalReason.UNKNOWN_RECIPE, detail="no recipe 'cube'", state=CellState.READY)
    done = run("start", "cube", "--url", url)
    assert done.exit_code == 5
    assert "cube" in done.stderr
    assert not cell.runs


def test_the_status_says_what_is_measured_and_what_keeps_the_cell(url: str, cell: WireCell) -> None:
    done = run("status", "--url", url)
    assert done.exit_code == 0
    assert "READY" in done.stdout
    assert "standing" in done.stdout
    cell.fault(FaultCode.FORCE_CEILING, "36 N")
    wait_for_state(url, "LATCHED")
    assert "FORCE_CEILING" in run("status", "--url", url).stdout
    assert json.loads(run("status", "--json", "--url", url).stdout)["latch"]["code"] == "FORCE_CEILING"
    cell.heartbeat = False
    wait_for_state(url, "UNKNOWN")
    assert run("status", "--url", url).exit_code == 4


def test_a_reset_acknowledges_the_fault_in_force_and_names_the_operator(url: str, cell: WireCell) -> None:
    nothing = run("reset", "--operator", "M. Sato", "--url", url)
    assert nothing.exit_code == 5
    assert "NOT_LATCHED" in nothing.stderr
    assert run("reset", "--url", url).exit_code == 2
    cell.fault(FaultCode.FORCE_CEILING)
    wait_for_state(url, "LATCHED")
    other = run("reset", "--operator", "M. Sato", "--acknowledge", "STALE", "--url", url)
    assert other.exit_code == 5
    done = run("reset", "--operator", "M. Sato", "--comment", "chip removed", "--url", url)
    assert done.exit_code == 0, done.output
    assert "FORCE_CEILING" in done.stdout
    request = cell.resets[-1]
    assert (request.requested_by, request.comment, request.acknowledge) == (
        "M. Sato",
        "chip removed",
        FaultCode.FORCE_CEILING,
    )


def test_runs_are_listed_newest_first(url: str, cell: WireCell) -> None:
    assert "no run yet" in run("runs", "--url", url).stdout
    for seed in ("1", "2"):
        assert run("start", "--seed", seed, "--url", url).exit_code == 0
        cell.succeed()
        wait_for_state(url, "READY")
    found = json.loads(run("runs", "--json", "--url", url).stdout)
    assert [item["seed"] for item in found] == [2, 1]
    assert run("runs", "--limit", "1", "--url", url).stdout.count(RECIPE) == 1


@pytest.mark.parametrize("command", [["start"], ["status"], ["reset", "--operator", "a"], ["runs"], ["watch"]])
def test_without_an_api_each_command_says_in_one_line_what_to_start(command: list[str]) -> None:
    done = run(*command, "--url", f"http://127.0.0.1:{free_port()}")
    assert done.exit_code == 4
    assert "dsl-assembly serve" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_an_address_that_is_none_is_a_usage_error() -> None:
    done = run("status", "--url", "127.0.0.1:8000")
    assert done.exit_code == 2
    assert "http://127.0.0.1:8000" in done.stderr


def test_the_address_may_come_from_the_environment(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DSL_ASSEMBLY_URL", url)
    assert run("status").exit_code == 0
