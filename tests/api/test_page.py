"""The operator's page in a real browser, where Debian's chromium is installed."""

import shutil
from collections.abc import AsyncIterator

import pytest
from playwright.async_api import Page, async_playwright

from service.faults import FaultCode
from service.messages import EventKind
from tests.api.wire_cell import RECIPE, Api, WireCell, until

CHROMIUM = shutil.which("chromium")
ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed (apt-get install chromium)")


@pytest.fixture
async def page(api: Api) -> AsyncIterator[Page]:
    """The page at 1280x800 in a browser that reports what the page did wrong and whom else it asked."""
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        page = await browser.new_page(viewport={"width": 1280, "height": 800})
        wrong: list[str] = []
        asked: list[str] = []
        page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        await page.goto(f"http://127.0.0.1:{api.port}/")
        await shows(page, "READY")
        yield page
        api.close_streams()
        await browser.close()
        refusals = ("409", "503")  # the browser reports every refused request as an error of its own
        assert [text for text in wrong if not any(status in text for status in refusals)] == []
        assert all(url.startswith(f"http://127.0.0.1:{api.port}/") for url in asked)


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


async def test_a_server_that_is_gone_is_unknown(page: Page, api: Api) -> None:
    await page.route("**/events*", lambda route: route.abort())
    api.close_streams()
    await shows(page, "UNKNOWN")
    assert "No connection" in (await page.text_content("#reason") or "")


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
