"""RTDE service of the emulated controller: clients' recipes, reserved inputs, data packages, text messages.

Source: UR's RTDE guide; where it is silent, the expectations of UR's own clients and `ur_rtde`.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from sim_backend.ur_controller.controller import Controller
from sim_backend.ur_controller.events import CompileFailed, Event, RuntimeFailed
from sim_backend.ur_controller.listener import Connection
from sim_backend.ur_controller.outputs import Outputs
from wire.rtde.codec import REQUEST_LIMIT, FrameReader, PackageType, Recipe, Value
from wire.rtde.errors import FramingError, PackageError, RtdeErrorReason
from wire.rtde.fields import INPUTS, OUTPUTS, SINCE, FieldType
from wire.rtde.messages import (
    PROTOCOL_VERSION,
    ControllerVersion,
    InputsRequest,
    Level,
    OutputsRequest,
    SetupReply,
    TextMessage,
    decode_version_request,
    encode_accepted,
)

TICK_RATE_HZ = 500
MAX_INPUT_RECIPES = 255
"""Input recipes per client: the recipe id is one byte, and 0 means a refused recipe."""
_SOURCE = "RTDE interface"
_OUTPUT_RECIPE_ID = 1  # the only output recipe of a client


@dataclass(frozen=True, slots=True)
class _Outputs:
    """Agreed outputs of one client."""

    recipe: Recipe
    getters: tuple[Callable[[], Value], ...]
    every: int
    """Ticks from one package to the next."""


class _Client:
    """Protocol state of one connection."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self.reader = FrameReader(REQUEST_LIMIT)
        self.version = 1  # until the client asks for another
        self.outputs: _Outputs | None = None
        self.inputs: list[Recipe] = []
        self.started = False


class RtdeService:
    """Serves RTDE to any number of clients.

    A variable of a client's input recipe is reserved for that client until it disconnects; for others it is IN_USE.
    Inputs are accepted before the client has started its outputs, because some clients only write. A slow reader misses
    packages, which are not sent later.

    Attributes:
        sent: data packages sent.
        skipped: data packages left out because their client had not read the earlier ones.
    """

    def __init__(self, controller: Controller, outputs: Outputs) -> None:
        self.sent = 0
        self.skipped = 0
        self._controller = controller
        self._getters = outputs.getters
        self._version = ControllerVersion(*controller.versions)
        self._clients: dict[Connection, _Client] = {}
        self._holders: dict[str, _Client] = {}
        self._tick = 0
        self._handlers: dict[int, Callable[[_Client, bytes], None]] = {
            PackageType.PROTOCOL_VERSION: self._agree_version,
            PackageType.CONTROLLER_VERSION: self._tell_version,
            PackageType.SETUP_OUTPUTS: self._set_up_outputs,
            PackageType.SETUP_INPUTS: self._set_up_inputs,
            PackageType.START: self._start,
            PackageType.PAUSE: self._pause,
            PackageType.DATA: self._take_inputs,
            PackageType.TEXT: self._take_text,
        }
        controller.events.append(self._on_event)

    def on_connect(self, connection: Connection) -> None:
        self._clients[connection] = _Client(connection)

    def on_data(self, connection: Connection, data: bytes) -> None:
        """Handle complete packages; bytes that are not RTDE end the connection."""
        client = self._clients[connection]
        try:
            for kind, payload in client.reader.feed(data):
                handler = self._handlers.get(kind)
                if handler is None:
                    raise PackageError(RtdeErrorReason.UNKNOWN_PACKAGE, f"RTDE has no package type {kind}")
                handler(client, payload)
        except (FramingError, PackageError):
            connection.close()

    def on_close(self, connection: Connection) -> None:
        client = self._clients.pop(connection)
        self._holders = {name: holder for name, holder in self._holders.items() if holder is not client}

    def publish(self) -> None:
        """Send the packages that are due at this tick."""
        self._tick += 1
        for client in self._clients.values():
            outputs = client.outputs
            if outputs is None or not client.started or self._tick % outputs.every:
                continue
            if client.connection.pending:
                self.skipped += 1
                continue
            client.connection.send(outputs.recipe.encode([get() for get in outputs.getters]))
            self.sent += 1

    def _agree_version(self, client: _Client, payload: bytes) -> None:
        version = decode_version_request(payload)
        accepted = 1 <= version <= PROTOCOL_VERSION
        if accepted:
            client.version = version
        client.connection.send(encode_accepted(PackageType.PROTOCOL_VERSION, accepted))

    def _tell_version(self, client: _Client, _payload: bytes) -> None:
        client.connection.send(self._version.encode())

    def _set_up_outputs(self, client: _Client, payload: bytes) -> None:
        """Agree on an output recipe; a refused one leaves the previous one in force."""
        unnumbered = client.version == 1
        try:
            request = OutputsRequest.decode(payload, client.version)
        except PackageError:  # too many names, or no frequency
            client.connection.send(SetupReply((), None if unnumbered else 0).encode(PackageType.SETUP_OUTPUTS))
            return
        frequency_hz = TICK_RATE_HZ if request.frequency_hz is None else request.frequency_hz
        types = tuple(self._type_of(name, OUTPUTS) for name in request.names)
        accepted = 1 <= frequency_hz <= TICK_RATE_HZ and _all_known(types)
        if accepted:
            client.outputs = _Outputs(
                recipe=_recipe(request.names, types, None if unnumbered else _OUTPUT_RECIPE_ID),
                getters=tuple(self._getters[name] for name in request.names),
                every=math.floor(TICK_RATE_HZ / frequency_hz),
            )
        recipe_id = _OUTPUT_RECIPE_ID if accepted else 0
        client.connection.send(SetupReply(types, None if unnumbered else recipe_id).encode(PackageType.SETUP_OUTPUTS))

    def _set_up_inputs(self, client: _Client, payload: bytes) -> None:
        """Agree on one more input recipe; a refused one reserves nothing and takes no number."""
        try:
            names = InputsRequest.decode(payload).names
        except PackageError:  # too many names
            client.connection.send(SetupReply((), 0).encode(PackageType.SETUP_INPUTS))
            return
        types = tuple(
            RtdeErrorReason.IN_USE if self._holders.get(name, client) is not client else self._type_of(name, INPUTS)
            for name in names
        )
        recipe_id = 0
        if len(client.inputs) < MAX_INPUT_RECIPES and _all_known(types):
            recipe_id = len(client.inputs) + 1
            client.inputs.append(_recipe(names, types, recipe_id))
            self._holders.update(dict.fromkeys(names, client))
        client.connection.send(SetupReply(types, recipe_id).encode(PackageType.SETUP_INPUTS))

    def _start(self, client: _Client, _payload: bytes) -> None:
        client.started = client.outputs is not None
        client.connection.send(encode_accepted(PackageType.START, client.started))

    def _pause(self, client: _Client, _payload: bytes) -> None:
        client.started = False
        client.connection.send(encode_accepted(PackageType.PAUSE, True))

    def _take_inputs(self, client: _Client, payload: bytes) -> None:
        if not payload or not 1 <= payload[0] <= len(client.inputs):
            number = payload[0] if payload else "missing"
            self._tell(client, Level.ERROR, f"Input recipe {number} has not been set up, its data are ignored")
            return
        recipe = client.inputs[payload[0] - 1]
        try:
            values = recipe.decode(payload)
        except PackageError as error:  # the frames are still in step: ur_rtde 1.6.5 misnumbers one of its recipes
            self._tell(client, Level.ERROR, f"Ignored: {error}")
            return
        self._controller.apply_inputs(recipe.names, values)

    def _take_text(self, _client: _Client, payload: bytes) -> None:
        """Check a client's message for PolyScope's log, which the emulation does not keep."""
        TextMessage.decode(payload)

    def _type_of(self, name: str, table: Mapping[str, FieldType]) -> str:
        kind = table.get(name)
        if kind is None or SINCE.get(name, (0, 0, 0)) > self._version[:3]:
            return RtdeErrorReason.NOT_FOUND
        return kind.name

    def _on_event(self, event: Event) -> None:
        """Report a failed program to the clients."""
        if isinstance(event, RuntimeFailed):
            level, text = Level.EXCEPTION, event.text
        elif isinstance(event, CompileFailed):
            level, text = Level.ERROR, event.text
        else:
            return
        for client in self._clients.values():
            self._tell(client, level, text)

    def _tell(self, client: _Client, level: Level, text: str) -> None:
        """Send a text message, unless data has not started or in version 1, where it would disturb a set-up
        under way.
        """
        if client.started and client.version >= PROTOCOL_VERSION:
            client.connection.send(TextMessage(text, _SOURCE, level).encode())


def _all_known(types: Sequence[str]) -> bool:
    return bool(types) and all(kind in FieldType.__members__ for kind in types)


def _recipe(names: Sequence[str], types: Sequence[str], recipe_id: int | None) -> Recipe:
    return Recipe(names, [FieldType[kind] for kind in types], recipe_id)
