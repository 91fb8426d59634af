"""Checks on every request before the application sees it: local address, Host, Origin, body length. Adds headers.

Any page that a browser on the operator's machine shows can make the browser send requests here. Three checks stop such
requests. The connection must arrive on a loopback address. `Host` must be a name of this machine, so a rebound name is
refused. A request that changes something must come from this server's own page or from no page at all.

A stop passes none of these checks; `api.stop_rule` has its own.
"""

import functools
import ipaddress
import logging
import time
import uuid
from collections.abc import Collection
from urllib.parse import urlsplit

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.problems import problem_response
from api.stop_rule import READING_METHODS, STOP_PATH, is_stop, why_hostile

BODY_LIMIT_BYTES = 16 * 1024

SECURITY_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}

_log = structlog.get_logger("api.request")


class Protection:
    """The outermost ASGI middleware.

    Args:
        app: application to protect.
        hosts: names that a `Host` header may hold, besides the loopback names.
        allow_remote: True: accept connections that arrive on an address other than loopback.
    """

    def __init__(self, app: ASGIApp, hosts: Collection[str] = (), allow_remote: bool = False) -> None:
        self._app = app
        self._hosts = frozenset(host.lower() for host in hosts)
        self._allow_remote = allow_remote

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":  # there are no websockets here; one is closed before its handshake
            await send({"type": "websocket.close", "code": 1008, "reason": "not served"})
            return
        request_id = uuid.uuid4().hex[:16]
        structlog.contextvars.clear_contextvars()
        structlog.contextvars.bind_contextvars(request_id=request_id)
        started = time.perf_counter()
        answered: dict[str, int] = {}

        async def send_protected(message: Message) -> None:
            if message["type"] == "http.response.start":
                answered["status"] = message["status"]
                headers = MutableHeaders(scope=message)
                headers.setdefault("Cache-Control", "no-store")
                headers["X-Request-ID"] = request_id
                headers.raw.extend(_SECURITY_HEADERS)
            await send(message)

        try:
            await self._checked(scope, receive, send_protected)
        finally:
            status = answered.get("status", 0)
            # Pages and probes read several times a second, so only a failed read is logged above debug level.
            quiet = scope["method"] in READING_METHODS and 0 < status < 400
            _log.log(
                logging.DEBUG if quiet else logging.INFO,
                "request",
                method=scope["method"],
                path=scope["path"],
                status=status,
                duration_ms=round(1e3 * (time.perf_counter() - started), 2),
            )

    async def _checked(self, scope: Scope, receive: Receive, send: Send) -> None:
        asks_for_stop = is_stop(scope["method"], scope["path"])
        refusal = self._refusal_of_stop(scope) if asks_for_stop else self._refusal(scope)
        if refusal is not None:
            status, reason, detail = refusal
            confirmed = False if asks_for_stop else None
            answer = problem_response(Request(scope), status, detail, reason=reason, confirmed=confirmed)
            await answer(scope, receive, send)
            return
        if asks_for_stop:
            plain = {"method": "POST", "path": STOP_PATH, "raw_path": STOP_PATH.encode(), "root_path": ""}
            # A stop needs no body, so a body must neither delay nor refuse it.
            await self._app({**scope, **plain}, _empty_body(receive), send)
            return
        await self._app(scope, _limited(receive), send)

    def _refusal_of_stop(self, scope: Scope) -> tuple[int, str, str] | None:
        why = why_hostile(Headers(scope=scope), self._hosts)
        return None if why is None else (403, "CROSS_SITE", f"This page may not stop the cell: {why}.")

    def _refusal(self, scope: Scope) -> tuple[int, str, str] | None:
        headers = Headers(scope=scope)
        server = scope.get("server")
        arrived = None if server is None or server[1] is None else server[0]  # a Unix socket has no port
        if not (self._allow_remote or arrived is None or is_loopback(arrived)):
            return (
                403,
                "NOT_LOOPBACK",
                (
                    f"This cell is served on loopback only, and the request came in on {arrived}. There is no "
                    "authorisation yet: set allow_remote in the API's settings to accept other machines nevertheless."
                ),
            )
        host = headers.get("host", "")
        if not (_hostname(host) in self._hosts or is_loopback(_hostname(host))):
            return 421, "UNKNOWN_HOST", f"Host {host!r} is not a name of this cell; add it to allowed_hosts if it is."
        if scope["method"] not in READING_METHODS:
            origin = headers.get("origin")
            site = headers.get("sec-fetch-site", "none")
            if origin is not None and _netloc(origin) != host.lower():
                return 403, "CROSS_SITE", f"This page may not command the cell: its origin is {origin}."
            if site not in {"none", "same-origin"}:
                return 403, "CROSS_SITE", f"This page may not command the cell: the browser calls it {site}."
        length = headers.get("content-length", "0")
        if length.isdigit() and int(length) > BODY_LIMIT_BYTES:
            return 413, "BODY_TOO_LARGE", _TOO_LARGE_TEXT
        return None


_SECURITY_HEADERS = [(name.lower().encode(), value.encode()) for name, value in SECURITY_HEADERS.items()]
"""As ASGI has them; no answer of the application sets one of them."""
_TOO_LARGE_TEXT = f"The body is longer than {BODY_LIMIT_BYTES} bytes."


def _limited(receive: Receive) -> Receive:
    total = 0

    async def counted() -> Message:
        nonlocal total
        message = await receive()
        total += len(message.get("body", b""))
        if total > BODY_LIMIT_BYTES:
            raise HTTPException(413, _TOO_LARGE_TEXT)
        return message

    return counted


def _empty_body(receive: Receive) -> Receive:
    first = True

    async def empty() -> Message:
        nonlocal first
        if first:
            first = False
            return {"type": "http.request", "body": b"", "more_body": False}
        return await receive()

    return empty


def _hostname(host: str) -> str:
    try:
        return (urlsplit(f"//{host}").hostname or "").lower()
    except ValueError:
        return ""


def _netloc(origin: str) -> str | None:
    try:
        return urlsplit(origin).netloc.lower()
    except ValueError:
        return None


@functools.lru_cache(maxsize=256)
def is_loopback(address: str) -> bool:
    """Return whether an address is `localhost` or a loopback address."""
    if address == "localhost":
        return True
    try:
        parsed = ipaddress.ip_address(address)
    except ValueError:
        return False
    mapped = getattr(parsed, "ipv4_mapped", None)
    return (mapped or parsed).is_loopback
