"""The place of each request in the order of stops: noted when its head arrives, before anything is waited for."""

from dataclasses import dataclass

from starlette.types import ASGIApp, Receive, Scope, Send

from service.messages import StopMark

KEY = "receipt"
"""Name of the receipt in a request's state."""


@dataclass(frozen=True, slots=True)
class Receipt:
    """A place in the order of stops.

    Attributes:
        mark: newest one that was known of the control process.
        stops_asked: stops that this server had been asked for, delivered or not.
    """

    mark: StopMark | None
    stops_asked: int


class Receipts:
    """ASGI middleware that gives every request its receipt.

    Args:
        app: application whose `state.runtime` knows the cell.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            scope.setdefault("state", {})[KEY] = scope["app"].state.runtime.cell.receive()
        await self._app(scope, receive, send)
