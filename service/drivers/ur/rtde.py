"""Asyncio client of RTDE, protocol version 2: it reads every package, queues nothing, and reports every failure.

Packages are decoded where their bytes arrive, without a task or a queue in between, so a receiver sees them in order
and without delay. The client works on asyncio's own loop and on uvloop.
"""

import asyncio
import contextlib
import math
from collections.abc import Callable, Sequence
from typing import TypeVar, cast

from service.drivers.ur.rtde_link import LinkError, RtdeLink, open_link
from wire.rtde.codec import HEADER_SIZE, Decoded, PackageType, Recipe, Value, frame
from wire.rtde.errors import PackageError, RtdeError, RtdeErrorReason
from wire.rtde.messages import (
    PORT,
    PROTOCOL_VERSION,
    ControllerVersion,
    InputsRequest,
    OutputsRequest,
    SetupReply,
    TextMessage,
    decode_accepted,
    encode_version_request,
)

RATE_HZ = 500
"""Rate of the controller's real-time loop; data packages come at every n-th tick of it."""
_LONGEST_TEXT = HEADER_SIZE + 3 + 2 * 0xFF

_T = TypeVar("_T")


class RtdeClient:
    """One client of one controller; the same three calls connect it again after a loss.

    Call `connect`, `setup` and `start` in this order. Each raises its failure, and an error closes the connection.
    After `start` a loss is reported once, through `on_lost`.

    Args:
        host: address of the controller.
        port: port of its RTDE service.
        clock: returns monotonic time, s, for `arrival_s`.
        on_package: receives the values of a data package in the order of the recipe, as `Recipe.decode` returns them,
            and the time of arrival; packages that arrive together share it. An exception from it ends the connection.
        on_lost: receives the reason why the connection ended.
        on_text: receives the controller's text messages.
        timeout_s: longest duration of each step of the connection, s.
        silence_s: a connection without data for this long is lost; the loss is noticed within twice the time, real
            time. None if silence is normal, as in a world that is advanced step by step.

    Attributes:
        controller_version: version of the controller that answered last.
        outputs: recipe of the data packages that arrive.
        inputs: recipes that may be sent, in the order of `setup`.
        received: data packages since `connect`, like all counters.
        skipped: packages left out by the controller, derived from gaps of the timestamps.
        out_of_order: packages not newer than the previous one; they are delivered too.
        dropped: inputs that could not be sent at once.
    """

    def __init__(
        self,
        host: str,
        port: int = PORT,
        *,
        clock: Callable[[], float],
        on_package: Callable[[tuple[Decoded, ...], float], None],
        on_lost: Callable[[RtdeError], None],
        on_text: Callable[[TextMessage], None] = lambda message: None,
        timeout_s: float = 2.0,
        silence_s: float | None = 1.0,
    ) -> None:
        self.name = f"RTDE at {host}:{port}"
        self.controller_version: ControllerVersion | None = None
        self.outputs: Recipe | None = None
        self.inputs: tuple[Recipe, ...] = ()
        self.received = self.skipped = self.out_of_order = self.dropped = 0
        self._address = (host, port)
        self._clock = clock
        self._on_package = on_package
        self._on_lost = on_lost
        self._on_text = on_text
        self._timeout_s = timeout_s
        self._silence_s = silence_s
        self._link: RtdeLink | None = None
        self._stamp_at = 0
        self._packages_per_s = 0.0
        self._newest_stamp = 0.0

    @property
    def ready(self) -> bool:
        """The controller's data arrive; a connection alone does not suffice."""
        return self._link is not None and self._link.error is None and self.received > 0

    async def connect(self) -> None:
        """Connect to the controller and agree on the protocol; an older connection is dropped.

        Raises:
            LinkError: there is no controller, no answer in time, or another protocol version.
            RtdeError: the peer's answer is not RTDE.
        """
        self._drop()
        self.outputs, self.inputs = None, ()
        self.received = self.skipped = self.out_of_order = self.dropped = 0
        try:
            async with asyncio.timeout(self._timeout_s):
                self._link = await open_link(
                    *self._address, self.name, self._receive, self._on_text, self._lost, self._clock
                )
        except OSError as error:
            late = isinstance(error, TimeoutError)
            text = f"{self.name}: {f'no connection in {self._timeout_s} s' if late else error}"
            hint = "is the controller on, the address right, RTDE enabled under Security/Services?"
            raise LinkError(
                RtdeErrorReason.TIMEOUT if late else RtdeErrorReason.UNREACHABLE, f"{text}; {hint}"
            ) from error
        accepted = await self._ask(encode_version_request(), PackageType.PROTOCOL_VERSION, decode_accepted)
        if not accepted:
            self._drop()
            text = f"{self.name} does not speak version {PROTOCOL_VERSION} of the protocol: update its software"
            raise LinkError(RtdeErrorReason.REFUSED, text)
        kind = PackageType.CONTROLLER_VERSION
        self.controller_version = await self._ask(frame(kind), kind, ControllerVersion.decode)

    async def setup(self, outputs: Sequence[str], frequency_hz: float, inputs: Sequence[Sequence[str]] = ()) -> None:
        """Agree on the received variables and on those that may be sent.

        Args:
            outputs: variables to receive, `timestamp` among them.
            frequency_hz: rate of the data packages, 1 to 500; the controller sends every `floor(500 / f)`-th tick.
            inputs: variables of each input recipe.

        Raises:
            SetupError: the controller does not know a variable, or another client holds it; the error names each.
            LinkError: there is no connection, or no answer in time.
            RtdeError: the answer is malformed.
            ValueError: the outputs lack the timestamp, or RTDE does not have the frequency.
        """
        if "timestamp" not in outputs:
            raise ValueError("the outputs need `timestamp`: skipped packages are counted from it")
        if not 1 <= frequency_hz <= RATE_HZ:
            raise ValueError(f"RTDE sends at 1 to {RATE_HZ} Hz, not at {frequency_hz} Hz")
        self._newest_stamp = -math.inf
        self._stamp_at = outputs.index("timestamp")
        self._packages_per_s = RATE_HZ / (RATE_HZ // frequency_hz)
        request = OutputsRequest(tuple(outputs), float(frequency_hz)).encode()
        self.outputs = await self._agree(request, PackageType.SETUP_OUTPUTS, outputs)
        self.inputs = tuple(
            [
                await self._agree(InputsRequest(tuple(names)).encode(), PackageType.SETUP_INPUTS, names)
                for names in inputs
            ]
        )

    async def start(self) -> None:
        """Start the data; return once the first package has arrived.

        Raises:
            LinkError: the controller refuses, or no data come in time.
            RtdeError: the data do not match the recipe.
        """
        link = self._link_or_error()
        if self.outputs is not None:
            link.limit(max(HEADER_SIZE + self.outputs.size, _LONGEST_TEXT))
        if not await self._ask(frame(PackageType.START), PackageType.START, decode_accepted):
            self._drop()
            raise LinkError(
                RtdeErrorReason.REFUSED, f"{self.name} does not start the data; is an output recipe set up?"
            )
        if not self.received:
            await self._ask(b"", PackageType.DATA, len)
        self._link_or_error()
        link.started = True
        if self._silence_s is not None:
            self._watch(link, self._silence_s, -1)

    def send(self, recipe: int, values: Sequence[Value]) -> bool:
        """Send the values of one input recipe now, or not at all.

        Args:
            recipe: index of the recipe in `setup`'s `inputs`.
            values: one value for each of its variables.

        Returns:
            True if they left. False if the link is not ready or does not take them at once; they are then counted in
                `dropped` and not queued, since the next values replace them.

        Raises:
            PackageError: a value does not fit its variable.
        """
        package = self.inputs[recipe].encode(values)
        if self._link is not None and self.ready and self._link.send_now(package):
            return True
        self.dropped += 1
        return False

    async def close(self) -> None:
        """End the connection. If data flow, the controller has then read everything that was sent before."""
        link = self._link
        if self.ready:
            with contextlib.suppress(RtdeError):
                await self._ask(frame(PackageType.PAUSE), PackageType.PAUSE, decode_accepted)
        self._drop()
        if link is not None:
            await link.closed

    async def _agree(self, request: bytes, kind: PackageType, names: Sequence[str]) -> Recipe:
        return await self._ask(request, kind, lambda payload: SetupReply.decode(payload).recipe(names))

    async def _ask(self, request: bytes, kind: PackageType, read: Callable[[bytes], _T]) -> _T:
        """Send a request and return the payload of the answer, decoded by `read`; on any error, close the
        connection.
        """
        link = self._link_or_error()
        try:
            async with asyncio.timeout(self._timeout_s):
                return read(await link.ask(request, kind))
        except TimeoutError:
            self._drop()
            said = f"; it said: {link.last_text}" if link.last_text else ""
            text = f"{self.name} did not answer {kind.name} in {self._timeout_s} s{said}"
            raise LinkError(RtdeErrorReason.TIMEOUT, text) from None
        except BaseException:
            self._drop()
            raise

    def _link_or_error(self) -> RtdeLink:
        if self._link is None:
            raise LinkError(RtdeErrorReason.CLOSED, f"{self.name}: no connection; connect first")
        if self._link.error is not None:
            raise self._link.error
        return self._link

    def _drop(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            link.fail(LinkError(RtdeErrorReason.CLOSED, f"{self.name}: closed from this side"))

    def _receive(self, payload: bytes, arrival_s: float) -> None:
        if self.outputs is None:
            raise PackageError(RtdeErrorReason.UNEXPECTED, "data before any were asked for")
        values = self.outputs.decode(payload)
        stamp = cast("float", values[self._stamp_at])
        if not 0.5 < (stamp - self._newest_stamp) * self._packages_per_s < 1.5:
            self._note_gap(stamp)
        self._newest_stamp = stamp
        self.received += 1
        self._on_package(values, arrival_s)

    def _note_gap(self, stamp: float) -> None:
        if not math.isfinite(stamp):
            raise PackageError(RtdeErrorReason.MALFORMED, f"a timestamp of {stamp}")
        if not self.received:
            return
        steps = round((stamp - self._newest_stamp) * self._packages_per_s)
        if steps > 0:
            self.skipped += steps - 1
        else:
            self.out_of_order += 1

    def _watch(self, link: RtdeLink, silence_s: float, received: int) -> None:
        if link is not self._link or link.error is not None:
            return
        if self.received == received:
            link.fail(LinkError(RtdeErrorReason.TIMEOUT, f"{self.name}: no data for {silence_s} s"))
        else:
            asyncio.get_running_loop().call_later(silence_s, self._watch, link, silence_s, self.received)

    def _lost(self, link: RtdeLink, error: RtdeError) -> None:
        if link is self._link and link.started:
            self._on_lost(error)
