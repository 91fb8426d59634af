"""Connections of the server: their number is bounded, and a stop needs neither a free place nor a well-formed request.

uvicorn takes the class by `http=Connection`. Without a bound, idle connections use up the process's file handles, and
the system then resets every new connection, that of a stop included.
"""

import asyncio
import functools
import resource
from collections.abc import Iterable
from typing import cast
from urllib.parse import unquote

import h11
from starlette.types import Message, Scope
from uvicorn.protocols.http.h11_impl import STATUS_PHRASES, H11Protocol, RequestResponseCycle

from api.stop_rule import is_stop

MOST_CONNECTIONS = 512
"""Connections held at once; beyond it the oldest idle one is closed for each new one."""
MOST_WAITING = 2048
"""Connections that the system may hand over in one turn of the loop, before older ones are closed for them."""
HANDLES_ELSEWHERE = 128
"""File handles kept for the database, Zenoh, logs and started processes."""
HEAD_BYTES = 8192


@functools.cache
def raise_handle_limit() -> int:
    """Raise this process's limit of open files as far as the system permits; return it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    return resource.getrlimit(resource.RLIMIT_NOFILE)[0]


def most_connections() -> int:
    """Return the bound of connections: `MOST_CONNECTIONS`, or less where the system permits few open files."""
    return min(MOST_CONNECTIONS, (raise_handle_limit() - HANDLES_ELSEWHERE) // 4)


def most_waiting() -> int:
    """Return the length of the queue in which the system holds new connections."""
    return min(MOST_WAITING, (raise_handle_limit() - HANDLES_ELSEWHERE) // 2)


class Connection(H11Protocol):
    """One connection of a client.

    Attributes:
        since: time on the loop's clock at which it was made or last answered, s.
        stopping: it carries a stop that is not answered yet.
    """

    since = 0.0
    stopping = False
    _head = b""

    @property
    def is_idle(self) -> bool:
        """True while no request is open. One whose head is still to come is none."""
        return not self.stopping and self._open is None

    @property
    def _open(self) -> RequestResponseCycle | None:
        cycle = cast("RequestResponseCycle | None", self.cycle)  # None before the first request
        return None if cycle is None or cycle.response_complete else cycle

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take the connection, and close an older one if there are too many."""
        super().connection_made(transport)
        self.since = self.loop.time()
        if len(self.connections) > most_connections():
            self._make_room()

    def _make_room(self) -> None:
        others = [other for other in self.connections if isinstance(other, Connection) and other is not self]
        oldest = _oldest(other for other in others if other.is_idle)
        oldest = oldest or _oldest(other for other in others if not other._carries_stop)
        if oldest is not None:
            self.connections.discard(oldest)
            oldest.transport.abort()

    @property
    def _carries_stop(self) -> bool:
        request = self._open
        return self.stopping or (request is not None and is_stop(request.scope["method"], request.scope["path"]))

    def data_received(self, data: bytes) -> None:
        """Take in bytes; a stop behind an unfinished request does not wait for it."""
        if self.stopping:
            return  # whatever follows a stop
        if self.is_idle:
            self._head = (self._head + data)[:HEAD_BYTES]
        super().data_received(data)
        if not self.is_idle:
            self._head = b""
            waiting = bytes(self.conn.trailing_data[0]) if self.conn.their_state is h11.DONE else b""
            if waiting and (scope := self._stop_in(waiting)) is not None:
                self._carry_out(scope)

    def eof_received(self) -> bool | None:  # type: ignore[override]
        """Keep the connection for the answer to a stop. A stop whose head was cut off is one."""
        if self._head and (scope := self._stop_in(self._head)) is not None:
            self._carry_out(scope)
        if self.stopping:
            return True
        if self._carries_stop:
            self.cycle.keep_alive = False
            return True
        return None

    def send_400_response(self, msg: str) -> None:
        """Refuse what cannot be read, unless it is a stop or follows one."""
        if self._carries_stop:
            return
        if (scope := self._stop_in(self._head)) is not None:
            self._carry_out(scope)
            return
        super().send_400_response(msg)

    def on_response_complete(self) -> None:
        """Be idle again."""
        self.since, self._head = self.loop.time(), b""
        super().on_response_complete()

    def shutdown(self) -> None:
        """End when the server does; a client that does not read its answer is not waited for."""
        super().shutdown()
        if self.flow.write_paused:
            self.transport.abort()

    def _stop_in(self, head: bytes) -> Scope | None:
        """Return the request if the bytes begin with that of a stop, however it goes on."""
        line, *rest = head.split(b"\n")
        method, target, *_ = [*line.split(), b"", b""]
        raw_path, _, query = target.partition(b"?")
        path = unquote(raw_path.decode("latin-1"))
        if not is_stop(method.decode("latin-1"), path):
            return None
        headers: list[tuple[bytes, bytes]] = []
        for text in rest:
            if not text.strip():
                break
            name, _, value = text.partition(b":")
            headers.append((name.strip().lower(), value.strip()))
        return {
            "type": "http",
            "asgi": {"version": self.asgi_version, "spec_version": "2.3"},
            "http_version": "1.1",
            "server": self.server,
            "client": self.client,
            "scheme": self.scheme,
            "method": "POST",
            "root_path": "",
            "path": path,
            "raw_path": raw_path,
            "query_string": query,
            "headers": headers,
            "state": self.app_state.copy(),
        }

    def _carry_out(self, scope: Scope) -> None:
        """Carry a stop out, answer it if no other answer has begun, and close the connection."""
        request = self._open
        answers = request is None or not request.response_started
        if request is not None:
            request.disconnected = True
            request.message_event.set()
        self.stopping = True
        task = self.loop.create_task(self._answer(scope, answers))
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    async def _answer(self, scope: Scope, answers: bool) -> None:
        parts: list[bytes] = []

        async def receive() -> Message:
            return {"type": "http.disconnect"}

        async def send(message: Message) -> None:
            if message["type"] == "http.response.start":
                status = message["status"]
                lines = [b"HTTP/1.1 %d %s" % (status, STATUS_PHRASES[status])]
                lines += [name + b": " + value for name, value in message["headers"]]
                parts.append(b"\r\n".join([*lines, b"connection: close", b"", b""]))
            else:
                parts.append(message.get("body", b""))

        try:
            await self.app(scope, receive, send)  # type: ignore[arg-type]
        finally:
            if answers:
                self.transport.write(b"".join(parts))
            self.transport.close()


def _oldest(connections: Iterable[Connection]) -> Connection | None:
    return min(connections, key=lambda connection: connection.since, default=None)
