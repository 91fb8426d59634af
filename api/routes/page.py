"""The operator's page. It is rendered here and kept live by its script; it loads nothing from other servers."""

import os
from html import escape
from pathlib import Path
from string import Template

from fastapi import APIRouter
from fastapi.responses import HTMLResponse
from fastapi.staticfiles import StaticFiles
from starlette.middleware.gzip import GZipMiddleware
from starlette.responses import Response
from starlette.types import Scope

from api.runtime import RuntimeDependency
from service.messages import CellState

router = APIRouter(include_in_schema=False)

FOLDER = Path(__file__).parents[1] / "page"
_TEMPLATE = Template((FOLDER / "index.html").read_text(encoding="utf-8"))


class _Files(StaticFiles):
    """Files that a browser keeps, and asks for again only whether they have changed."""

    def file_response(
        self, full_path: str | os.PathLike[str], stat_result: os.stat_result, scope: Scope, status_code: int = 200
    ) -> Response:
        response = super().file_response(full_path, stat_result, scope, status_code)
        response.headers["Cache-Control"] = "no-cache"
        return response


FILES = GZipMiddleware(_Files(directory=FOLDER), thread_minimum_size=0)  # compressing must not hold a stop up


@router.get("/", response_class=HTMLResponse)
async def page(runtime: RuntimeDependency) -> HTMLResponse:
    config = runtime.config
    # The state comes with the first event, because a rendered page is out of date when it arrives.
    return HTMLResponse(
        _TEMPLATE.substitute(
            cell=escape(config.cell.id),
            state=CellState.UNKNOWN.value,
            mark="?",
            reason="Connecting. The robot's state is not known here yet.",
            driver=escape(config.cell.driver),
            recipes="".join(f"<option>{escape(name)}</option>" for name in config.recipes),
        )
    )
