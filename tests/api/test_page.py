"""The operator's page in a real browser, where Debian's chromium is installed."""

import shutil
from collections.abc import AsyncIterator

import pytest
from playwright.async_api import BrowserContext, Page, async_playwright

from service.faults import FaultCode
from service.messages import CellState, EventKind
from tests.api.wire_cell import RECIPE, Api, WireCell, until

CHROMIUM = shutil.which("chromium")
ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed (apt-get install chromium)")


@pytest.fixture
async def browser() -> AsyncIterator[BrowserContext]:
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield await browser.new_context(viewport={"width": 1280, "height": 800})
        await browser.close()


@pytest.fixture
async def page(api: Api, browser: BrowserContext) -> AsyncIterator[Page]:
    """The page at 1280x800 in a browser that reports what the page did wrong and whom else it asked."""
    page = await browser.new_page()
    wrong: list[str] = []
    asked: list[str] = []
    page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    await open_page(page, api)
    yield page
    api.close_streams()
    # The browser reports every refused request, and one without an answer, as an error of its own.
    own = ("409", "503", "ERR_CONNECTION_REFUSED")
    assert [text for text in wrong if not any(part in text for part in own)] == []
    assert all(url.startswith(f"http://127.0.0.1:{api.port}/") for url in asked)


async def open_page(page: Page, api: Api) -> None:
    await page.goto(f"http://127.0.0.1:{api.port}/")
    await shows(page, "READY")


async def six_windows(browser: BrowserContext, api: Api) -> list[Page]:
    windows = [await browser.new_page() for _ in range(6)]
    for window in windows:
        await open_page(window, api)
    return windows


async def shows(page: Page, state: str) -> None:
    await page.wait_for_selector(f'body[data-state="{state}"]', timeout=15_000)
    assert await page.text_content("#state") == state


async def test_start_and_stop_by_the_page(page: Page, cell: WireCell) -> None:
    await page.fill("#seed", "7")
    await page.click("#start")
    await shows(page, "RUNNING")
    assert cell.runs[0].seed == 7
    assert cell.runs[0].idempotency_key
    await page.click("#stop")
    await shows(page, "LATCHED")
    await page.wait_for_selector("#answer:has-text('Stopped: standstill is measured')")
    assert len(cell.stops) == 1


async def test_a_reset_needs_a_name_and_a_look(page: Page, cell: WireCell) -> None:
    cell.fault(FaultCode.FORCE_CEILING)
    await shows(page, "LATCHED")
    assert "FORCE_CEILING" in (await page.text_content("#reason") or "")
    await page.click("#reset")
    await page.fill("#operator", "M. Sato")
    await page.click("#reset")
    assert not cell.resets
    await page.check("#looked")
    await page.click("#reset")
    await shows(page, "READY")
    assert cell.resets[0].acknowledge is FaultCode.FORCE_CEILING
    assert not await page.is_checked("#looked")


async def test_a_silent_control_process_is_unknown_and_stop_stays_enabled(page: Page, cell: WireCell) -> None:
    assert await page.text_content("#ceiling") == "30"
    cell.heartbeat = False
    await shows(page, "UNKNOWN")
    assert await page.text_content("#ceiling") == "–", "nobody knows which one is in force"
    assert await page.is_disabled("#start")
    assert await page.text_content("#force") == "–"
    assert await page.is_enabled("#stop")
    await page.click("#stop")
    await until(lambda: cell.stops)
    cell.heartbeat = True
    await shows(page, "READY")


async def test_a_server_that_is_gone_is_unknown_and_its_stop_is_not_confirmed(page: Page, api: Api) -> None:
    api.server.should_exit = True
    api.close_streams()
    await shows(page, "UNKNOWN")
    assert "No connection" in (await page.text_content("#reason") or "")
    await until(lambda: not api.server.server_state.connections)
    await page.click("#stop")
    await page.wait_for_selector("#answer.bad:has-text('NOT CONFIRMED')")
    assert "robot's own emergency stop" in (await page.text_content("#answer") or "")


async def test_75_a_stop_without_an_answer_is_shown_as_not_confirmed(page: Page, cell: WireCell) -> None:
    await page.route("**/stop*", lambda _route: None)  # asked, and never answered
    await page.click("#stop")
    await page.wait_for_selector("#answer.bad:has-text('NOT CONFIRMED within a second')")
    await page.unroute("**/stop*")
    cell.arm_stops = False
    await page.click("#start")
    await shows(page, "RUNNING")
    await page.click("#stop")
    await page.wait_for_selector("#answer.bad:has-text('standstill is not measured')")
    assert "NOT CONFIRMED" in (await page.text_content("#answer") or "")


@pytest.mark.parametrize("has_worker", [True, False], ids=["worker", "no worker"])
async def test_74_stop_stops_with_six_windows_open(
    api: Api, cell: WireCell, browser: BrowserContext, has_worker: bool
) -> None:
    if not has_worker:
        await browser.add_init_script("delete window.SharedWorker")
    windows = [await browser.new_page() for _ in range(6)]
    for window in windows:
        await window.goto(f"http://127.0.0.1:{api.port}/", wait_until="commit" if not has_worker else "load")
        if has_worker:
            await shows(window, "READY")
    if has_worker:
        assert api.subscribers == 1
        await windows[0].click("#start")
    else:
        await api.http.post("/start", json={"recipe": RECIPE})
    await until(lambda: cell.state is CellState.RUNNING)
    await windows[3].click("#stop")
    await until(lambda: cell.state is CellState.LATCHED)
    await windows[3].wait_for_selector("#answer.good:has-text('Stopped: standstill is measured')")
    api.close_streams()


async def test_74_stop_passes_the_waiting_requests_of_six_windows(
    api: Api, cell: WireCell, browser: BrowserContext
) -> None:
    windows = await six_windows(browser, api)
    cell.hold_starts = True
    for window in windows:
        await window.click("#start")
    await until(lambda: len(cell.held) >= 5)
    await windows[5].click("#stop")
    await until(lambda: cell.stops)
    await windows[5].wait_for_selector("#answer.good:has-text('Stopped: standstill is measured')")
    cell.release()
    api.close_streams()


async def test_74_the_windows_that_stay_live_on_when_others_are_closed(
    api: Api, cell: WireCell, browser: BrowserContext
) -> None:
    windows = await six_windows(browser, api)
    for window in windows[:5]:
        await window.close()
    await api.http.post("/start", json={"recipe": RECIPE})
    await shows(windows[5], "RUNNING")
    assert api.subscribers == 1
    await windows[5].click("#stop")
    await until(lambda: cell.stops)
    await shows(windows[5], "LATCHED")
    api.close_streams()


async def test_74_a_page_whose_worker_is_gone_opens_a_stream_of_its_own(
    api: Api, cell: WireCell, browser: BrowserContext
) -> None:
    page = await browser.new_page()
    await page.route("**/shared-link.js", lambda route: route.fulfill(body="", content_type="text/javascript"))
    await browser.route("**/shared-link.js", lambda route: route.fulfill(body="", content_type="text/javascript"))
    await open_page(page, api)
    await page.click("#start")
    await shows(page, "RUNNING")
    await page.click("#stop")
    await until(lambda: cell.stops)
    api.close_streams()


async def test_the_first_tab_stop_is_stop_and_enter_presses_it(page: Page, cell: WireCell) -> None:
    await page.keyboard.press("Tab")
    assert await page.evaluate("document.activeElement.id") == "stop"
    await page.keyboard.press("Enter")
    await until(lambda: cell.stops)


async def test_it_fits_1280_by_800_without_scrolling_in_every_state(page: Page, cell: WireCell) -> None:
    for number in range(30):
        cell.tell(EventKind.WARNING, f"a long line of the journal, number {number}, that is longer than its column")
    for code in (None, FaultCode.FORCE_CEILING):
        if code is not None:
            cell.fault(code, "31.2 N on one sample, ceiling 30.0 N, 2.1 mm below the surface, in the third press")
            await shows(page, "LATCHED")
        await page.wait_for_selector("#journal li")
        size = await page.evaluate("[document.documentElement.scrollHeight, document.documentElement.scrollWidth]")
        assert size == [800, 1280]
        for part in ("#stop", "#start", "#reset", "#force-plot", "#depth-plot", "#runs", "footer"):
            box = await page.locator(part).bounding_box()
            assert box is not None
            assert box["y"] + box["height"] <= 800, part


async def test_it_says_that_it_is_no_emergency_stop(page: Page) -> None:
    text = await page.inner_text("footer")
    assert "not the robot's emergency stop" in text
    assert "certified safety" in text


async def test_the_runs_table_shows_the_outcome(page: Page, cell: WireCell) -> None:
    await page.select_option("#recipe", RECIPE)
    await page.click("#start")
    await shows(page, "RUNNING")
    cell.succeed()
    await page.wait_for_selector("#runs td.good:has-text('inserted')", timeout=15_000)


async def test_plots_follow_the_telemetry(page: Page, cell: WireCell) -> None:
    for index in range(20):
        cell.trace(t=0.02 * index, force_n=float(index))
        await page.wait_for_timeout(20)
    await page.wait_for_selector("#depth:has-text('3.0')", timeout=15_000)
    assert await page.locator("#force-plot canvas").count() == 1
    assert "ceiling" in await page.inner_text("#force-plot")
