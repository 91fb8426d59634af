"""The files of the operator's page: compressed, and asked for again only whether they have changed."""

from pathlib import Path

import pytest

from api.routes.page import FOLDER
from tests.api.wire_cell import Api

NAMES = [path.relative_to(FOLDER).as_posix() for path in sorted(FOLDER.rglob("*.js"))]


@pytest.mark.parametrize("name", NAMES)
async def test_a_script_comes_compressed_and_a_second_time_not_at_all(lonely_api: Api, name: str) -> None:
    first = await lonely_api.http.get(f"/page/{name}", headers={"Accept-Encoding": "gzip"})
    assert first.headers["Content-Encoding"] == "gzip"
    assert first.text == Path(FOLDER, name).read_text(encoding="utf-8")
    assert first.headers["Cache-Control"] == "no-cache", "a browser keeps it, and asks"
    again = await lonely_api.http.get(f"/page/{name}", headers={"If-None-Match": first.headers["ETag"]})
    assert (again.status_code, again.content) == (304, b"")
    changed = await lonely_api.http.get(f"/page/{name}", headers={"If-None-Match": '"another"'})
    assert (changed.status_code, changed.text) == (200, first.text)


async def test_what_is_measured_is_neither_kept_nor_compressed(api: Api) -> None:
    for path in ("/", "/status", "/runs"):
        answer = await api.http.get(path, headers={"Accept-Encoding": "gzip"})
        assert answer.headers["Cache-Control"] == "no-store"
        assert "Content-Encoding" not in answer.headers
    async with api.http.stream("GET", "/events", headers={"Accept-Encoding": "gzip"}) as events:
        assert events.headers["Content-Type"].startswith("text/event-stream")
        assert "Content-Encoding" not in events.headers


def test_the_page_loads_the_small_form_of_its_library() -> None:
    vendored = [path.name for path in (FOLDER / "vendor").glob("*.js")]
    assert vendored == ["uPlot.iife.min.js"]
    assert f"/page/vendor/{vendored[0]}" in (FOLDER / "index.html").read_text()
