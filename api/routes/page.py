"""The operator's page. It is rendered here and kept live by its script; it loads nothing from other servers."""

from html import escape
from pathlib import Path
from string import Template

from fastapi import APIRouter
from fastapi.responses import HTMLResponse

from api.runtime import RuntimeDependency
from service.messages import CellState

router = APIRouter(include_in_schema=False)

FOLDER = Path(__file__).parents[1] / "page"
_TEMPLATE = Template((FOLDER / "index.html").read_text(encoding="utf-8"))


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
