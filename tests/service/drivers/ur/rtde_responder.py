"""An RTDE service without a robot, for tests of the client: says what a test wants it to say."""

import asyncio
from types import TracebackType
from typing import Self

from wire.rtde.codec import Decoded, FrameReader, PackageType, Recipe
from wire.rtde.fields import INPUTS, OUTPUTS, FieldType
from wire.rtde.messages import (
    ControllerVersion,
    InputsRequest,
    OutputsRequest,
    SetupReply,
    TextMessage,
    decode_version_request,
    encode_accepted,
)

VERSION = ControllerVersion(5, 21, 3, 11)
TICK_S = 0.002


class RtdeResponder:
    """Listens on `host` on a free port; time passes with `tick` only.

    Attributes:
        in_use: inputs that somebody else holds.
        mute: package types that get no answer.
        speaks: whether it accepts the version of the protocol.
        starts: whether it accepts the start, and whether it then sends.
        frequencies_hz: that clients asked for.
        received: values of each data package, by recipe id.
        texts: messages from clients.
        clients: open connections.
    """

    def __init__(self, host: str = "127.0.0.23") -> None:
        self.host = host
        self.port = 0
        self.time_s = 60.0
        self.in_use: set[str] = set()
        self.mute: set[PackageType] = set()
        self.speaks = True
        self.starts = True
        self.frequencies_hz: list[float | None] = []
        self.received: list[tuple[int, tuple[Decoded, ...]]] = []
        self.clients: list[_Client] = []
        self._server: asyncio.Server | None = None

    async def __aenter__(self) -> Self:
        server = await asyncio.get_running_loop().create_server(lambda: _Client(self), self.host, self.port)
        self.port = server.sockets[0].getsockname()[1]
        self._server = server
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._server is not None
        self._server.close()
        self.hang_up()
        await self._server.wait_closed()
        await asyncio.sleep(0.01)

    def hang_up(self) -> None:
        for client in self.clients:
            client.transport.abort()

    def tick(self, count: int = 1) -> None:
        """Let time pass and send each client that started one package per tick."""
        for _ in range(count):
            self.time_s += TICK_S
            for client in self.clients:
                client.publish()

    def skip(self, count: int) -> None:
        """Let time pass without a package, as a controller that is short of time."""
        self.time_s += count * TICK_S

    def say(self, raw: bytes) -> None:
        for client in self.clients:
            client.transport.write(raw)

    def values(self, recipe: Recipe) -> list[float | tuple[float, ...]]:
        """A value for each variable: the time, or numbers that tell the variables apart."""
        values: list[float | tuple[float, ...]] = []
        for place, (name, kind) in enumerate(zip(recipe.names, recipe.types, strict=True)):
            if name == "timestamp":
                values.append(self.time_s)
            elif kind is FieldType.BOOL:
                values.append(True)
            else:
                values.append(place if kind.count == 1 else tuple(place + i for i in range(kind.count)))
        return values


class _Client(asyncio.Protocol):
    def __init__(self, responder: RtdeResponder) -> None:
        self._responder = responder
        self._reader = FrameReader()
        self._outputs: Recipe | None = None
        self._inputs: dict[int, Recipe] = {}
        self.running = False
        self.transport: asyncio.Transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport) or hasattr(transport, "write")
        self.transport = transport  # type: ignore[assignment]
        self._responder.clients.append(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._responder.clients.remove(self)

    def data_received(self, data: bytes) -> None:
        for number, payload in self._reader.feed(data):
            kind = PackageType(number)
            if kind not in self._responder.mute and (answer := self._answer(kind, payload)):
                self.transport.write(answer)

    def publish(self) -> None:
        if self.running and self._outputs is not None:
            self.transport.write(self._outputs.encode(self._responder.values(self._outputs)))

    def _answer(self, kind: PackageType, payload: bytes) -> bytes:
        responder = self._responder
        match kind:
            case PackageType.PROTOCOL_VERSION:
                return encode_accepted(kind, responder.speaks and decode_version_request(payload) == 2)
            case PackageType.CONTROLLER_VERSION:
                return VERSION.encode()
            case PackageType.SETUP_OUTPUTS:
                request = OutputsRequest.decode(payload)
                responder.frequencies_hz.append(request.frequency_hz)
                reply = self._reply(request.names, {name: kind.name for name, kind in OUTPUTS.items()}, 1)
                self._outputs = reply.recipe(request.names) if reply.recipe_id else None
                return reply.encode(kind)
            case PackageType.SETUP_INPUTS:
                names = InputsRequest.decode(payload).names
                known = {name: kind.name for name, kind in INPUTS.items()}
                reply = self._reply(names, known | dict.fromkeys(responder.in_use, "IN_USE"), len(self._inputs) + 1)
                if reply.recipe_id:
                    self._inputs[reply.recipe_id] = reply.recipe(names)
                return reply.encode(kind)
            case PackageType.START:
                self.running = responder.starts
                return encode_accepted(kind, responder.starts)
            case PackageType.PAUSE:
                self.running = False
                return encode_accepted(kind, True)
            case PackageType.DATA:
                responder.received.append((payload[0], self._inputs[payload[0]].decode(payload)))
                return b""
            case PackageType.TEXT:
                TextMessage.decode(payload)
                return b""

    @staticmethod
    def _reply(names: tuple[str, ...], known: dict[str, str], recipe_id: int) -> SetupReply:
        types = tuple(known.get(name, "NOT_FOUND") for name in names)
        return SetupReply(types, 0 if {"NOT_FOUND", "IN_USE"} & set(types) else recipe_id)
