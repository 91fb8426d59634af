"""Zenoh sessions: explicit endpoints, no discovery, no unrequested listening, queries on an event loop."""

import asyncio
import json
import os
from collections.abc import Callable, Sequence
from typing import Any

import zenoh

from wire.endpoints import EndpointError, EndpointInUseError
from wire.tls import Access, Certificates

UNREAD_S = 0.5
"""Time for which a query or an answer waits for a peer that does not read, s; then the link to that peer is closed."""

RETRY_MS = 100
"""Period in which a peer that does not listen is tried again, ms."""

RECEIVING_THREADS = 32
"""Zenoh's threads that receive, two by default. A link to a frozen peer occupies one for some time when it ends, and
while all are occupied no stop arrives."""

os.environ.setdefault("ZENOH_RUNTIME", f"(rx: (worker_threads: {RECEIVING_THREADS}))")  # read at the first opening


class QueryRefusedError(Exception):
    """The other side answered with an error; the text is the other side's."""


def open_session(
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    certificates: Certificates | None = None,
    access: Access | None = None,
) -> zenoh.Session:
    """Open a session in peer mode on exactly these endpoints; the caller closes it.

    A failed connection is retried in the background, so a peer may start later.

    Args:
        listen: endpoints to accept peers at, such as `tcp/127.0.0.1:7447`.
        connect: endpoints of peers or routers to join.
        certificates: of this process, for `tls/` and `quic/` endpoints.
        access: rights of the peers that connect; None grants everything to everyone who connects.

    Raises:
        EndpointInUseError: another process listens at an endpoint.
        EndpointError: listening at an endpoint fails for another reason; the text names it.
    """
    config = zenoh.Config()
    settings: dict[str, object] = {
        "mode": "peer",
        "listen/endpoints": list(listen),
        "listen/exit_on_failure": True,
        "connect/endpoints": list(connect),
        "connect/exit_on_failure": False,
        "connect/timeout_ms": -1,
        "connect/retry": {"period_init_ms": RETRY_MS, "period_max_ms": RETRY_MS, "period_increase_factor": 1.0},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/queue/batching/enabled": False,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": round(1e6 * UNREAD_S),
        "transport/shared_memory/enabled": False,  # a killed process would leave segments behind
    }
    for part in (certificates, access):
        settings |= {} if part is None else part.settings()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        where = ", ".join(listen)
        if "Address already in use" in str(error):
            raise EndpointInUseError(f"{where} is in use by another process") from error
        raise EndpointError(f"cannot listen at {where}: {str(error).split(' at /', 1)[0]}") from error


def close_session(session: zenoh.Session) -> None:
    """Close a session; an unclosed one can hang the interpreter's exit. Blocks for a few milliseconds."""
    session.close()


def call_in_loop(loop: asyncio.AbstractEventLoop, callback: Callable[..., object], *args: Any) -> None:
    """Run `callback` on the loop from one of Zenoh's threads, which may outlive the loop briefly at shutdown."""
    try:
        loop.call_soon_threadsafe(callback, *args)
    except RuntimeError:
        if not loop.is_closed():
            raise


async def query(session: zenoh.Session, selector: str, payload: bytes, timeout_s: float) -> list[bytes]:
    """Send a query and wait for every answer without blocking the loop.

    Args:
        session: open session.
        selector: key expression, with `?parameters` if there are any.
        payload: the request.
        timeout_s: time after which no further answer is awaited, s.

    Returns:
        One payload per answer; empty when nobody answered in time.

    Raises:
        QueryRefusedError: an answer is an error.
    """
    loop = asyncio.get_running_loop()
    answers: list[bytes] = []
    errors: list[str] = []
    ended = asyncio.Event()

    def on_reply(reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            answers.append(reply.ok.payload.to_bytes())
        elif reply.err is not None and (text := reply.err.payload.to_bytes().decode(errors="replace")) != "Timeout":
            errors.append(text)

    handler = zenoh.handlers.Callback(on_reply, lambda: call_in_loop(loop, ended.set))
    session.get(
        selector,
        handler,
        payload=payload,
        timeout=timeout_s,
        priority=zenoh.Priority.INTERACTIVE_HIGH,
        express=True,
        consolidation=zenoh.ConsolidationMode.NONE,
    )
    await ended.wait()
    if errors:
        raise QueryRefusedError("; ".join(errors))
    return answers
