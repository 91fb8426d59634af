"""One TCP connection to an RTDE service: it carries bytes, cuts and sorts packages, and keeps the reason of its end."""

import asyncio
import socket
from collections.abc import Callable
from typing import cast

from wire.rtde.codec import FrameReader, PackageType
from wire.rtde.errors import PackageError, RtdeError, RtdeErrorReason
from wire.rtde.messages import TextMessage

SEND_BUFFER = 2048
"""Send buffer of the socket, bytes; the smallest that Linux has, about six packages. A dead link holds back no more
than those, so nothing older reaches the arm when the link recovers.
"""

_DATA = int(PackageType.DATA)
_TYPES = frozenset(int(kind) for kind in PackageType)


class LinkError(RtdeError):
    """The connection failed or ended; `reason` gives the kind, the exception's cause an error in the received bytes."""


class RtdeLink(asyncio.Protocol):
    """One connection: it carries bytes and keeps the reason of its end.

    Attributes:
        error: reason of the failure; None while the connection holds.
        started: the owner wants to hear of a loss.
        last_text: the controller's last text message.
        closed: future that is done once the socket is closed.
    """

    def __init__(
        self,
        sock: socket.socket,
        name: str,
        on_data: Callable[[bytes, float], None],
        on_text: Callable[[TextMessage], None],
        on_lost: Callable[["RtdeLink", RtdeError], None],
        clock: Callable[[], float],
    ) -> None:
        self.error: RtdeError | None = None
        self.started = False
        self.last_text = ""
        self.closed: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._sock = sock
        self._name = name
        self._on_data = on_data
        self._on_text = on_text
        self._on_lost = on_lost
        self._clock = clock
        self._reader = FrameReader()
        self._transport: asyncio.Transport | None = None
        self._awaited: int | None = None
        self._reply: asyncio.Future[bytes] | None = None

    def limit(self, size: int) -> None:
        """Limit packages to `size` bytes from now on; a broken stream is detected sooner."""
        self._reader.limit = size

    async def ask(self, request: bytes, kind: PackageType) -> bytes:
        """Send a request and return the payload of the next package of type `kind`."""
        assert self._transport is not None  # noqa: S101 - `open_link` returns after `connection_made`
        self._awaited, self._reply = kind, asyncio.get_running_loop().create_future()
        try:
            self._transport.write(request)
            return await self._reply
        finally:
            self._awaited = self._reply = None

    def send_now(self, package: bytes) -> bool:
        """Pass a package to the system, or return False if the system takes none at present.

        The socket is written directly, because the transport would queue a package that cannot leave. If the system
        takes part of a package, the rest must follow and goes through the transport.
        """
        if self._transport is None or self._transport.get_write_buffer_size():
            return False
        try:
            sent = self._sock.send(package)
        except BlockingIOError:
            return False
        except OSError as error:
            self.fail(LinkError(RtdeErrorReason.CLOSED, f"{self._name}: {error}"))
            return False
        if sent < len(package):
            self._transport.write(package[sent:])
        return True

    def fail(self, error: RtdeError) -> None:
        """End the connection with a reason; the first reason stays."""
        if self.error is None:
            self.error = error
        if self._reply is not None and not self._reply.done():
            self._reply.set_exception(self.error)
        if self._transport is not None:
            self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)

    def data_received(self, data: bytes) -> None:
        arrival_s = self._clock()
        try:
            for kind, payload in self._reader.feed(data):
                if kind == _DATA:
                    self._on_data(payload, arrival_s)
                if kind == self._awaited:
                    self._answer(payload)
                elif kind != _DATA:
                    self._take_unasked(kind, payload)
                if self.error is not None:
                    return
        except RtdeError as error:
            failure = LinkError(error.reason, f"{self._name}: {error}")
            failure.__cause__ = error
            self.fail(failure)

    def connection_lost(self, exc: Exception | None) -> None:
        error = LinkError(RtdeErrorReason.CLOSED, f"{self._name}: {exc or 'the controller closed the connection'}")
        self.fail(error)
        self.closed.set_result(None)
        self._on_lost(self, self.error or error)

    def _answer(self, payload: bytes) -> None:
        self._awaited = None
        if self._reply is not None and not self._reply.done():
            self._reply.set_result(payload)

    def _take_unasked(self, kind: int, payload: bytes) -> None:
        if kind == PackageType.TEXT:
            message = TextMessage.decode(payload)
            self.last_text = message.message
            self._on_text(message)
        elif kind in _TYPES:
            raise PackageError(
                RtdeErrorReason.UNEXPECTED, f"an answer to {PackageType(kind).name} that nobody asked for"
            )
        else:
            raise PackageError(RtdeErrorReason.UNKNOWN_PACKAGE, f"a package of type {kind}, which RTDE does not have")


async def open_link(
    host: str,
    port: int,
    name: str,
    on_data: Callable[[bytes, float], None],
    on_text: Callable[[TextMessage], None],
    on_lost: Callable[[RtdeLink, RtdeError], None],
    clock: Callable[[], float],
) -> RtdeLink:
    """Connect to the first address of `host` that answers; raise OSError if none does."""
    loop = asyncio.get_running_loop()
    refusal = OSError(f"{host} has no address")
    for family, kind, proto, _, address in await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM):
        sock = socket.socket(family, kind, proto)
        try:
            sock.setblocking(False)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
            await loop.sock_connect(sock, address)
            link = RtdeLink(sock, name, on_data, on_text, on_lost, clock)
            await loop.create_connection(lambda link=link: link, sock=sock)
        except OSError as error:
            sock.close()
            refusal = error
        except BaseException:
            sock.close()
            raise
        else:
            return link
    raise refusal
