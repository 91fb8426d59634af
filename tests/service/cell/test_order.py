"""Starts, stops and resets in every order: the stop wins, and no run is told before it is one."""

import asyncio
import time
from pathlib import Path

import pytest
import zenoh

from service import messages
from service.cell.control_plane import ControlPlane
from service.cell.journal.ledger import FILE_NAME
from service.envelope import ENVELOPE_VERSION, QUERY_TICKET, Envelope, TicketRequest, TicketResult
from service.faults import FaultCode
from service.messages import (
    CellState,
    Message,
    RefusalReason,
    Refused,
    ResetRequest,
    RunResult,
    RunState,
    StartRequest,
    StatusResult,
    StopRequest,
)
from service.testing import RECIPE
from tests.service.cell import policies
from tests.service.cell.conftest import EASY
from tests.service.cell.raced_cell import assert_no_run_was_told, assert_nothing_moves, ends_well, ready_cell, reason_of
from tests.service.sim_server import free_endpoint
from wire.session import close_session, open_session, query

CELL = "under-test"


# --- the order of a start and a stop


@pytest.mark.parametrize("turns", [1, 2, 3, 4, 6, 9, 20])
async def test_61_a_stop_in_any_turn_after_a_start_refuses_it_or_stops_its_run(tmp_path: Path, turns: int) -> None:
    async with ready_cell(tmp_path) as (bench, driver):
        starting = asyncio.create_task(bench.cell.start(StartRequest(recipe=RECIPE, seed=EASY)))
        for _ in range(turns):
            await asyncio.sleep(0)
        bench.cell.stop(StopRequest())
        answer = await starting
        if isinstance(answer, RunResult):
            ended = await bench.ended(answer.run)
            assert (ended.state, ended.code) == (RunState.STOPPED, FaultCode.OPERATOR_STOP)
            assert bench.cell.state is CellState.LATCHED
        else:
            assert answer.problem.reason is RefusalReason.STOPPED
            assert bench.cell.state is CellState.READY
            assert_no_run_was_told(bench)
        await assert_nothing_moves(bench, driver)


async def test_61_a_start_received_before_a_stop_is_refused_however_late_it_arrives(tmp_path: Path) -> None:
    async with ready_cell(tmp_path) as (bench, driver):
        late = StartRequest(recipe=RECIPE, seed=EASY, after=bench.cell.mark)
        assert bench.cell.stop(StopRequest()).status.state is CellState.READY
        assert reason_of(await bench.cell.start(late)) is RefusalReason.STOPPED
        await assert_nothing_moves(bench, driver)
        await ends_well(bench)


async def test_61_a_start_that_is_repeated_under_its_key_is_as_old_as_the_first(tmp_path: Path) -> None:
    async with ready_cell(tmp_path) as (bench, driver):
        given_up = {"idempotency_key": "k", "valid_until": bench.cell.journal.clock() - 1.0}
        answer = await bench.cell.start(StartRequest(recipe=RECIPE, seed=EASY, **given_up))
        assert reason_of(answer) is RefusalReason.EXPIRED
        bench.cell.stop(StopRequest())
        again = await bench.cell.start(StartRequest(recipe=RECIPE, seed=EASY, idempotency_key="k"))
        assert reason_of(again) is RefusalReason.STOPPED
        await assert_nothing_moves(bench, driver)


@pytest.mark.parametrize("turns", [0, 1, 2, 4, 8])
@pytest.mark.parametrize("other", ["stop", "start", "reset"])
async def test_44_a_reset_moves_nothing_whatever_comes_in_between(tmp_path: Path, other: str, turns: int) -> None:
    async with ready_cell(tmp_path) as (bench, driver):
        late = StartRequest(recipe=RECIPE, seed=EASY, after=bench.cell.mark)
        bench.cell.halt(FaultCode.FORCE_CEILING, "injected")
        await bench.state(CellState.LATCHED)
        resetting = asyncio.create_task(bench.cell.reset(ResetRequest()))
        for _ in range(turns):
            await asyncio.sleep(0)
        if other == "stop":
            bench.cell.stop(StopRequest())
        elif other == "start":
            assert reason_of(await bench.cell.start(late)) in {RefusalReason.LATCHED, RefusalReason.STOPPED}
        else:
            await bench.cell.reset(ResetRequest())
        await resetting
        assert (bench.cell.state, bench.cell.journal.latch) == (CellState.READY, None)
        await assert_nothing_moves(bench, driver)


async def test_61_a_start_received_before_a_latch_does_not_survive_its_reset(tmp_path: Path) -> None:
    async with ready_cell(tmp_path) as (bench, driver):
        late = StartRequest(recipe=RECIPE, seed=EASY, after=bench.cell.mark)
        bench.cell.halt(FaultCode.FORCE_CEILING, "injected")
        await bench.state(CellState.LATCHED)
        assert isinstance(await bench.cell.reset(ResetRequest()), StatusResult)
        assert reason_of(await bench.cell.start(late)) is RefusalReason.STOPPED
        await assert_nothing_moves(bench, driver)


async def test_48_a_start_that_arrives_while_the_control_process_ends_is_refused(tmp_path: Path) -> None:
    async with ready_cell(tmp_path) as (bench, driver):
        close = driver.close
        answers: list[Message] = []

        async def close_slowly() -> None:
            async with asyncio.timeout(20):
                answers.append(await bench.cell.start(StartRequest(recipe=RECIPE, seed=EASY)))
            await close()

        driver.close = close_slowly  # type: ignore[method-assign]
        await bench.cell.close()
        driver.close = close  # type: ignore[method-assign]
        assert [reason_of(answer) for answer in answers] == [RefusalReason.STOPPED]
        assert driver.said("engage") == driver.said("target") == []
        assert_no_run_was_told(bench)


async def test_61_a_start_that_another_control_process_was_asked_for_is_refused(tmp_path: Path) -> None:
    async with ready_cell(tmp_path) as (bench, driver):
        mark = bench.cell.mark.model_copy(update={"service_epoch": "another"})
        answer = await bench.cell.start(StartRequest(recipe=RECIPE, seed=EASY, after=mark))
        assert reason_of(answer) is RefusalReason.STOPPED
        await assert_nothing_moves(bench, driver)


@pytest.mark.parametrize("first", ["start", "stop"])
@pytest.mark.parametrize("marked", [True, False], ids=["marked", "unmarked"])
async def test_61_of_a_start_and_a_stop_that_reach_the_loop_in_one_turn_the_stop_wins(
    tmp_path: Path, first: str, marked: bool
) -> None:
    endpoint = free_endpoint()
    session = open_session(listen=[endpoint])
    other = open_session(connect=[endpoint])
    answers: dict[str, bytes] = {}
    try:
        async with ready_cell(tmp_path) as (bench, driver):
            ControlPlane(bench.cell, session)
            start = StartRequest(recipe=RECIPE, seed=EASY, after=bench.cell.mark if marked else None)
            requests = {"start": (messages.START, start), "stop": (messages.STOP, StopRequest())}
            ticket = await a_ticket(other)
            for number, name in enumerate(sorted(requests, key=lambda one: one != first), 1):
                key, request = requests[name]
                enveloped = Envelope(
                    schema_version=ENVELOPE_VERSION, sender="tester", ticket=ticket, number=number, request=request
                )
                ask(other, name, key, enveloped, answers)
                time.sleep(0.3)  # the loop stands still: both are in its queue when it goes on
            async with asyncio.timeout(20):
                while len(answers) < 2:
                    await asyncio.sleep(0.01)
            stopped = messages.STATUS_ANSWER.validate_json(answers["stop"])
            assert stopped.kind == "status"
            started = messages.RUN_ANSWER.validate_json(answers["start"])
            assert reason_of(started) is RefusalReason.STOPPED
            await assert_nothing_moves(bench, driver)
            assert_no_run_was_told(bench)
    finally:
        await asyncio.to_thread(close_session, other)
        await asyncio.to_thread(close_session, session)


async def a_ticket(session: zenoh.Session) -> str:
    async with asyncio.timeout(20):
        while True:
            answers = await query(
                session,
                QUERY_TICKET.format(cell=CELL),
                TicketRequest(sender="tester").model_dump_json().encode(),
                1.0,
            )
            if answers:
                return TicketResult.model_validate_json(answers[0]).ticket


def ask(session: zenoh.Session, name: str, key: str, request: Message, answers: dict[str, bytes]) -> None:
    def on_reply(reply: zenoh.Reply) -> None:
        assert reply.ok is not None
        answers[name] = reply.ok.payload.to_bytes()

    session.get(key.format(cell=CELL), on_reply, payload=request.model_dump_json().encode(), timeout=20.0)


async def test_38_of_many_starts_at_once_exactly_one_is_accepted(tmp_path: Path) -> None:
    async with ready_cell(tmp_path) as (bench, driver):
        requests = [StartRequest(recipe=RECIPE, seed=EASY) for _ in range(20)]
        answers = await asyncio.gather(*(bench.cell.start(request) for request in requests))
        (accepted,) = [answer for answer in answers if isinstance(answer, RunResult)]
        assert {answer.problem.reason for answer in answers if isinstance(answer, Refused)} == {
            RefusalReason.WRONG_STATE
        }
        await bench.ended(accepted.run)
        assert len(driver.said("engage")) == 1
        assert [run.id for run in bench.cell.journal.newest(100)] == [accepted.run.id]


async def test_60_starts_at_once_with_one_key_are_one_run(tmp_path: Path) -> None:
    async with ready_cell(tmp_path) as (bench, driver):
        request = StartRequest(recipe=RECIPE, seed=EASY, idempotency_key="k")
        answers = await asyncio.gather(*(bench.cell.start(request) for _ in range(20)))
        answers.append(await bench.cell.start(request))
        runs = [answer for answer in answers if isinstance(answer, RunResult)]
        assert len(runs) == 21
        assert len({answer.run.id for answer in runs}) == 1
        assert [answer.created for answer in runs] == [True] + [False] * 20
        await bench.ended(runs[0].run)
        assert len(driver.said("engage")) == 1


@pytest.mark.parametrize("key", ["one", None], ids=["one_key", "no_key"])
async def test_71_refused_starts_by_the_dozen_leave_no_run_and_are_all_answered_with_the_refusal(
    tmp_path: Path, key: str | None
) -> None:
    async with ready_cell(tmp_path) as (bench, driver):
        policies.still(tmp_path).replace(tmp_path / "straight.onnx")  # refused only once its file has been read
        for _ in range(5):
            request = StartRequest(recipe=RECIPE, seed=EASY, idempotency_key=key)
            starts = [asyncio.create_task(bench.cell.start(request)) for _ in range(12)]
            while not all(start.done() for start in starts):
                assert_no_run_was_told(bench)
                await asyncio.sleep(0)
            reasons = {reason_of(start.result()) for start in starts}
            assert reasons <= {RefusalReason.POLICY_REFUSED, RefusalReason.WRONG_STATE}
            assert RefusalReason.POLICY_REFUSED in reasons
            assert key is None or len(reasons) == 1
        await assert_nothing_moves(bench, driver)
        assert_no_run_was_told(bench)
    assert '"run"' not in (tmp_path / "state" / FILE_NAME).read_text()


@pytest.mark.parametrize("step_s", [-86_400.0, 86_400.0], ids=["back", "forward"])
async def test_79_a_clock_of_day_that_is_set_changes_no_order_no_age_and_no_validity(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step_s: float
) -> None:
    async with ready_cell(tmp_path) as (bench, _):
        now = bench.cell.journal.time_of_day
        first = await bench.start(EASY, valid_until=bench.cell.journal.clock() + 30.0)
        await bench.state(CellState.APPROACH)
        monkeypatch.setattr(bench.cell.journal, "time_of_day", lambda: now() + step_s)
        ended = await bench.ended(first)
        assert ended.state is RunState.SUCCEEDED
        assert ended.ended_at is not None
        assert 0.0 <= ended.ended_at - ended.requested_at < 3600.0
        second = await bench.ended(await bench.start(EASY, valid_until=bench.cell.journal.clock() + 30.0))
        assert second.seq > first.seq
        assert [run.id for run in bench.cell.journal.newest(10)] == [second.id, first.id]
        assert [run.id for run in bench.cell.journal.newest(10, before=second.id)] == [first.id]
        assert [event.seq for event in bench.events] == sorted(event.seq for event in bench.events)
        assert bench.cell.status().measured is not None
