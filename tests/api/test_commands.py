import asyncio
from pathlib import Path

import pytest

from service.faults import FaultCode
from service.messages import CellState, Problem, RefusalReason
from tests.api.wire_cell import RECIPE, Api, WireCell, serving, until

PROBLEM = "application/problem+json"


async def test_a_start_is_accepted_with_the_run_and_where_to_follow_it(api: Api, cell: WireCell) -> None:
    response = await api.http.post("/start", json={"recipe": RECIPE, "seed": 7})
    assert response.status_code == 202
    run = response.json()
    assert (run["recipe"], run["seed"], run["state"]) == (RECIPE, 7, "ACTIVE")
    assert response.headers["Location"] == f"/runs/{run['id']}"
    followed = await api.http.get(response.headers["Location"])
    assert followed.json()["id"] == run["id"]
    await api.wait_for_state(CellState.RUNNING)
    assert len(cell.runs) == 1


async def test_the_same_idempotency_key_starts_nothing_twice(api: Api, cell: WireCell) -> None:
    key = {"Idempotency-Key": "k1"}
    answers = await asyncio.gather(
        *(api.http.post("/start", json={"recipe": RECIPE, "seed": 7}, headers=key) for _ in range(5))
    )
    assert {answer.status_code for answer in answers} == {202}
    assert len({answer.json()["id"] for answer in answers}) == 1
    assert sum("Idempotency-Replayed" in answer.headers for answer in answers) == 4
    assert len(cell.runs) == 1


async def test_an_idempotency_key_of_another_request_is_refused(api: Api) -> None:
    key = {"Idempotency-Key": "k1"}
    await api.http.post("/start", json={"recipe": RECIPE, "seed": 7}, headers=key)
    response = await api.http.post("/start", json={"recipe": RECIPE, "seed": 8}, headers=key)
    assert response.status_code == 422
    assert response.json()["reason"] == "IDEMPOTENCY_KEY_REUSED"


async def test_of_two_starts_one_is_accepted(api: Api, cell: WireCell) -> None:
    answers = await asyncio.gather(*(api.http.post("/start", json={"recipe": RECIPE}) for _ in range(2)))
    assert sorted(answer.status_code for answer in answers) == [202, 409]
    assert len(cell.runs) == 1


async def test_a_latched_cell_refuses_a_start_with_the_code(api: Api, cell: WireCell) -> None:
    cell.fault(FaultCode.FORCE_CEILING)
    response = await api.http.post("/start", json={"recipe": RECIPE})
    assert response.status_code == 409
    assert response.headers["content-type"] == PROBLEM
    problem = response.json()
    assert (problem["code"], problem["reason"], problem["state"]) == ("FORCE_CEILING", "LATCHED", "LATCHED")


async def test_27_a_policy_that_does_not_fit_is_422_with_the_mismatch(api: Api, cell: WireCell) -> None:
    cell.refuse_start = Problem(
        reason=RefusalReason.POLICY_REFUSED,
        detail="the policy wants hole_position, the cell has no camera",
        field="recipe",
    )
    response = await api.http.post("/start", json={"recipe": RECIPE})
    assert response.status_code == 422
    assert "hole_position" in response.json()["detail"]
    assert response.json()["errors"][0]["location"] == "body.recipe"


@pytest.mark.parametrize(
    "body",
    [
        {},
        {"recipe": "../../etc/passwd"},
        {"recipe": RECIPE, "seed": -1},
        {"recipe": RECIPE, "seed": True},
        {"recipe": RECIPE, "seed": 1.5},
        {"recipe": RECIPE, "force_ceiling_n": 500},
        [],
    ],
)
async def test_a_body_that_is_not_a_start_is_422_and_starts_nothing(api: Api, cell: WireCell, body: object) -> None:
    response = await api.http.post("/start", json=body)
    assert response.status_code == 422
    assert response.headers["content-type"] == PROBLEM
    assert response.json()["errors"]
    assert not cell.runs


@pytest.mark.parametrize(
    "text", ['{"recipe": "tr-2mm", "seed": 1e999}', "[" * 15000, "{", '"', "\x00", '{"recipe": NaN}']
)
async def test_json_bombs_and_garbage_are_4xx(api: Api, cell: WireCell, text: str) -> None:
    response = await api.http.post("/start", content=text, headers={"Content-Type": "application/json"})
    assert 400 <= response.status_code < 500
    assert response.headers["content-type"] == PROBLEM
    assert not cell.runs


async def test_a_start_for_a_silent_cell_is_503_and_is_not_delivered_later(api: Api, cell: WireCell) -> None:
    cell.heartbeat = False
    await api.wait_for_state(CellState.UNKNOWN)
    response = await api.http.post("/start", json={"recipe": RECIPE})
    assert response.status_code == 503
    assert response.json()["reason"] == "CELL_SILENT"
    assert not cell.runs


async def test_a_start_without_an_answer_says_that_acceptance_is_not_known(api: Api, cell: WireCell) -> None:
    cell.deaf_to_starts = True
    response = await api.http.post("/start", json={"recipe": RECIPE})
    assert response.status_code == 503
    assert "Idempotency-Key" in response.json()["detail"]


async def test_a_stop_answers_when_the_arm_is_measured_standing(api: Api, cell: WireCell) -> None:
    await api.http.post("/start", json={"recipe": RECIPE})
    response = await api.http.post("/stop")
    assert response.status_code == 200
    answer = response.json()
    assert answer["confirmed"] is True
    assert answer["state"] == "LATCHED"
    assert answer["measured"]["moving"] is False
    assert len(cell.stops) == 1


async def test_a_stop_whose_arm_still_moves_is_202_and_never_called_confirmed(api: Api, cell: WireCell) -> None:
    cell.arm_stops = False
    await api.http.post("/start", json={"recipe": RECIPE})
    response = await api.http.post("/stop")
    assert response.status_code == 202
    assert response.json()["confirmed"] is False
    assert response.json()["measured"]["moving"] is True


@pytest.mark.parametrize("state", [CellState.READY, CellState.LATCHED, CellState.OFFLINE, CellState.CONNECTING])
async def test_41_a_stop_of_any_caller_is_delivered_in_every_state(api: Api, cell: WireCell, state: CellState) -> None:
    cell.state = state
    response = await api.http.post("/stop")
    assert response.is_success
    assert cell.stops


@pytest.mark.parametrize("body", [b"", b"{", b"x" * 200_000, b'{"recipe": 1}'])
async def test_a_stop_looks_at_no_body(api: Api, cell: WireCell, body: bytes) -> None:
    response = await api.http.post("/stop", content=body, headers={"Content-Type": "application/json"})
    assert response.status_code == 200
    assert cell.stops


async def test_a_stop_passes_starts_that_wait_for_their_answer(api: Api, cell: WireCell) -> None:
    await api.http.post("/start", json={"recipe": RECIPE})
    cell.hold_starts = True
    waiting = [asyncio.create_task(api.http.post("/start", json={"recipe": RECIPE})) for _ in range(200)]
    await until(lambda: len(cell.held) == 200)
    response = await api.http.post("/stop")
    assert response.status_code == 200
    assert not any(task.done() for task in waiting)
    cell.release()
    assert {answer.status_code for answer in await asyncio.gather(*waiting)} == {503}


async def test_a_stop_passes_an_unusable_history(config_path: Path, cell: WireCell) -> None:
    (config_path.parent / "var").mkdir()
    (config_path.parent / "var" / "runs.sqlite").write_bytes(b"this is no database" * 100)
    async with serving(config_path) as api:
        await api.wait_for_state(CellState.READY)
        started = await api.http.post("/start", json={"recipe": RECIPE})
        assert started.status_code == 503
        assert started.json()["reason"] == "STORAGE"
        assert "runs.sqlite" in started.json()["detail"]
        assert not cell.runs
        assert (await api.http.post("/stop")).status_code == 200
        assert cell.stops


async def test_a_stop_that_reaches_nobody_says_so(lonely_api: Api) -> None:
    response = await lonely_api.http.post("/stop")
    assert response.status_code == 503
    assert response.json()["reason"] == "STOP_NOT_DELIVERED"
    assert "emergency stop" in response.json()["detail"]


async def test_a_stop_is_delivered_to_a_cell_that_beats_no_more(api: Api, cell: WireCell) -> None:
    cell.heartbeat = False
    await api.wait_for_state(CellState.UNKNOWN)
    await api.http.post("/stop")
    assert cell.stops


async def test_a_reset_acknowledges_the_code_that_the_operator_saw(api: Api, cell: WireCell) -> None:
    cell.fault(FaultCode.FORCE_CEILING)
    await api.wait_for_state(CellState.LATCHED)
    body = {"operator": "M. Sato", "comment": "chip removed", "acknowledge": "STALE"}
    assert (await api.http.post("/reset", json=body)).status_code == 409
    assert cell.state is CellState.LATCHED
    response = await api.http.post("/reset", json=body | {"acknowledge": "FORCE_CEILING"})
    assert response.status_code == 200
    assert response.json()["state"] == "READY"
    assert (cell.resets[-1].requested_by, cell.resets[-1].comment) == ("M. Sato", "chip removed")
    assert not cell.runs


async def test_42_a_reset_with_no_fault_is_409(api: Api) -> None:
    response = await api.http.post("/reset", json={"operator": "M. Sato"})
    assert response.status_code == 409
    assert response.json()["reason"] == "NOT_LATCHED"


async def test_a_reset_names_its_operator(api: Api, cell: WireCell) -> None:
    cell.fault(FaultCode.FORCE_CEILING)
    assert (await api.http.post("/reset", json={})).status_code == 422
    assert not cell.resets


async def test_a_stop_during_a_start_without_an_answer_is_not_held_up(api: Api, cell: WireCell) -> None:
    cell.hold_starts = True
    start = asyncio.create_task(api.http.post("/start", json={"recipe": RECIPE}))
    await until(lambda: cell.held)
    await api.http.post("/stop")
    await until(lambda: cell.stops)
    assert not start.done()
    cell.release()
    assert (await start).status_code == 503
