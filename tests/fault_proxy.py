"""A TCP proxy that spoils a connection as networks and peers do, for tests over real sockets."""

import asyncio
import random
import socket
from collections.abc import Awaitable, Callable, Iterable, Iterator
from types import TracebackType
from typing import Self

Spoil = Callable[[bytes], Iterable[bytes]]
"""Gives what leaves for one chunk that arrived: none, one or several pieces, each sent by itself."""

BUFFER = 4096
"""Bytes that the proxy takes from a peer while it passes nothing on, apart from what the system rounds up."""


def untouched(chunk: bytes) -> list[bytes]:
    return [chunk]


def chunked(generator: random.Random, largest: int) -> Spoil:
    """Pieces of 1 to `largest` bytes, whatever the packages were."""

    def spoil(chunk: bytes) -> Iterator[bytes]:
        at = 0
        while at < len(chunk):
            size = generator.randint(1, largest)
            yield chunk[at : at + size]
            at += size

    return spoil


def halved() -> Spoil:
    """Every chunk's second half leaves only with the first half of the next: no package arrives whole."""
    kept = b""

    def spoil(chunk: bytes) -> list[bytes]:
        nonlocal kept
        middle = len(chunk) // 2
        piece, kept = kept + chunk[:middle], chunk[middle:]
        return [piece] if piece else []

    return spoil


def duplicated(every: int) -> Spoil:
    """Every n-th chunk comes twice."""
    count = 0

    def spoil(chunk: bytes) -> list[bytes]:
        nonlocal count
        count += 1
        return [chunk, chunk] if count % every == 0 else [chunk]

    return spoil


def reordered(every: int) -> Spoil:
    """Every n-th chunk comes after the one that follows it."""
    count = 0
    kept = b""

    def spoil(chunk: bytes) -> list[bytes]:
        nonlocal count, kept
        count += 1
        if count % every == 0:
            kept = chunk
            return []
        pieces = [chunk, kept] if kept else [chunk]
        kept = b""
        return pieces

    return spoil


def garbled(generator: random.Random, every: int) -> Spoil:
    """Random bytes come before every n-th chunk."""
    count = 0

    def spoil(chunk: bytes) -> list[bytes]:
        nonlocal count
        count += 1
        return [generator.randbytes(generator.randint(1, 64)), chunk] if count % every == 0 else [chunk]

    return spoil


class Direction:
    """One way through the proxy, for all its connections.

    Attributes:
        spoil: see `Spoil`.
        delay_s: of every chunk.
        jitter_s: more of it, at random; order is kept, as TCP keeps it.
    """

    def __init__(self, generator: random.Random) -> None:
        self.spoil: Spoil = untouched
        self.delay_s = 0.0
        self.jitter_s = 0.0
        self._generator = generator
        self._open = asyncio.Event()
        self._open.set()

    def stall(self) -> None:
        """Pass nothing on and soon take nothing more: a black hole. What was taken comes late, as on a real network."""
        self._open.clear()

    def resume(self) -> None:
        self._open.set()

    async def pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        on_the_way: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue(64)
        sending = asyncio.create_task(self._send(on_the_way, writer))
        loop = asyncio.get_running_loop()
        try:
            while True:
                await self._open.wait()
                chunk = await reader.read(BUFFER)
                await self._open.wait()
                due = loop.time() + self.delay_s + self.jitter_s * self._generator.random()
                await on_the_way.put((due, chunk))
                if not chunk:
                    await sending
                    return
        finally:
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)

    async def _send(self, on_the_way: asyncio.Queue[tuple[float, bytes]], writer: asyncio.StreamWriter) -> None:
        loop = asyncio.get_running_loop()
        while True:
            due, chunk = await on_the_way.get()
            if due > loop.time():
                await asyncio.sleep(due - loop.time())
            if not chunk:
                writer.write_eof()
                return
            for piece in self.spoil(chunk):
                writer.write(piece)
                await writer.drain()
                await asyncio.sleep(0)


class FaultProxy:
    """Listens on `host` and passes every connection on to a service.

    Args:
        target: host and port of the service.
        host: to listen on, on a free port, which `port` then tells.
        seed: of everything that is random.

    Attributes:
        to_client: from service to client.
        to_service: from client to service.
        accepting: False hangs up on new clients at once.
    """

    def __init__(self, target: tuple[str, int], host: str = "127.0.0.1", seed: int = 0) -> None:
        self.host = host
        self.port = 0
        self.to_client = Direction(random.Random(seed))
        self.to_service = Direction(random.Random(seed + 1))
        self.accepting = True
        self._target = target
        self._server: asyncio.Server | None = None
        self._connections: dict[asyncio.Task[None], tuple[asyncio.StreamWriter, ...]] = {}

    async def __aenter__(self) -> Self:
        listening = socket.socket()
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
        listening.bind((self.host, 0))
        self._server = await asyncio.start_server(self._accept, sock=listening, limit=BUFFER)
        self.port = listening.getsockname()[1]
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._server is not None
        self._server.close()
        await self.reset()
        await self._server.wait_closed()

    @property
    def connections(self) -> int:
        return len(self._connections)

    async def reset(self) -> None:
        """Break every connection on both sides, as a cable or a switch that comes back without memory of them."""
        for task, writers in list(self._connections.items()):
            for writer in writers:
                hang_up(writer)
            task.cancel()
        await asyncio.gather(*self._connections, return_exceptions=True)

    async def _accept(self, from_client: asyncio.StreamReader, to_client: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        if not self.accepting:
            hang_up(to_client)
            return
        writers = [to_client]
        self._connections[task] = tuple(writers)
        pumps: list[Awaitable[None]] = []
        try:
            from_service, to_service = await asyncio.open_connection(*self._target, limit=BUFFER)
            self._connections[task] = (to_client, to_service)
            writers.append(to_service)
            pumps = [
                asyncio.create_task(self.to_service.pump(from_client, to_service)),
                asyncio.create_task(self.to_client.pump(from_service, to_client)),
            ]
            await asyncio.gather(*pumps)
        except (OSError, asyncio.CancelledError):
            for writer in writers:
                hang_up(writer)
        finally:
            for pump in pumps:
                pump.cancel()
            await asyncio.gather(*pumps, return_exceptions=True)
            for writer in writers:
                writer.close()
            del self._connections[task]


def hang_up(writer: asyncio.StreamWriter) -> None:
    """Close with a reset instead of an orderly end."""
    sock = writer.get_extra_info("socket")
    if sock is not None and sock.fileno() >= 0:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\0\0\0\0\0\0\0")
    writer.transport.abort()
