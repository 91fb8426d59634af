import asyncio
from pathlib import Path

from service.faults import FaultCode
from service.messages import CellState, Run, RunState
from tests.api.wire_cell import RECIPE, Api, WireCell, serving


def ended(number: int, state: RunState = RunState.SUCCEEDED) -> Run:
    return Run(id=f"run-{number}", recipe=RECIPE, seed=number, state=state, requested_at=1000.0 + number)


async def listed(api: Api, count: int, path: str = "/runs?limit=200") -> list[dict[str, object]]:
    async with asyncio.timeout(15):
        while True:
            runs = (await api.http.get(path)).json()["runs"]
            if len(runs) == count:
                return runs
            await asyncio.sleep(0.02)


async def test_a_run_stands_in_the_history_with_its_outcome(api: Api, cell: WireCell) -> None:
    run_id = (await api.http.post("/start", json={"recipe": RECIPE})).json()["id"]
    (active,) = await listed(api, 1)
    assert active["state"] == "ACTIVE"
    cell.succeed()
    async with asyncio.timeout(15):
        while (run := (await api.http.get(f"/runs/{run_id}")).json())["state"] == "ACTIVE":
            await asyncio.sleep(0.02)
    assert run["state"] == "SUCCEEDED"
    assert run["depth_m"] == 0.0102


async def test_runs_are_paged_newest_first_without_gap_or_repeat(cell: WireCell, config_path: Path) -> None:
    cell.runs = [ended(number) for number in range(1, 26)]
    async with serving(config_path) as api:
        await listed(api, 25)
        path, seen = "/runs?limit=10", []
        while path:
            response = await api.http.get(path)
            page = response.json()
            seen += [run["id"] for run in page["runs"]]
            path = page["next"]
            assert ("Link" in response.headers) == (path is not None)
    assert seen == [f"run-{number}" for number in range(25, 0, -1)]


async def test_what_happened_while_the_api_was_away_is_read_from_the_ledger(cell: WireCell, config_path: Path) -> None:
    async with serving(config_path) as api:
        await api.wait_for_state(CellState.READY)
        await api.http.post("/start", json={"recipe": RECIPE})
        await listed(api, 1)
    cell.fault(FaultCode.FORCE_CEILING)
    cell.runs += [ended(number) for number in range(2, 6)]
    async with serving(config_path) as api:
        runs = await listed(api, 5)
        async with asyncio.timeout(15):
            while (await api.http.get("/runs/run-1")).json()["code"] != "FORCE_CEILING":
                await asyncio.sleep(0.02)
    assert {run["state"] for run in runs} <= {"SUCCEEDED", "LATCHED", "ACTIVE"}


async def test_the_history_is_readable_while_the_control_process_is_silent(api: Api, cell: WireCell) -> None:
    await api.http.post("/start", json={"recipe": RECIPE})
    await listed(api, 1)
    cell.heartbeat = False
    await api.wait_for_state(CellState.UNKNOWN)
    assert len((await api.http.get("/runs")).json()["runs"]) == 1


async def test_a_page_size_out_of_range_is_422(api: Api) -> None:
    for query in ("limit=0", "limit=201", "limit=x"):
        assert (await api.http.get(f"/runs?{query}")).status_code == 422


async def test_a_page_after_an_unknown_run_is_404(api: Api) -> None:
    assert (await api.http.get("/runs?before=none-such")).status_code == 404
