"""Commands to a cell: each is an envelope under the command's own key, good for one use."""

import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import TypeVar

from pydantic import ValidationError

from service.cell.tickets import Tickets, Use
from service.envelope import ENVELOPE_VERSION, Envelope, Presence, TicketRequest
from service.messages import Message, RefusalReason, ResetRequest, StartRequest, StopRequest

_QUOTED = 80

RequestT = TypeVar("RequestT", bound=Message)
CommandT = TypeVar("CommandT", StartRequest, StopRequest, ResetRequest)
"""Requests that say who asks."""


class NotACommandError(Exception):
    """A message that is no command. It has had no effect.

    Attributes:
        reason: kind of the refusal.
        field: the field that is wrong, where one is.
    """

    def __init__(self, reason: RefusalReason, text: str, field: str | None = None) -> None:
        super().__init__(text)
        self.reason = reason
        self.field = field


class Reception:
    """Reads what arrives for one cell, and writes what it refuses to the journal.

    Args:
        tell: writes a line to the journal, or thins a flood of them out.
        clock: monotonic seconds.
    """

    def __init__(self, tell: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._tell = tell
        self._tickets = Tickets(clock)

    def draw_ticket(self, request: TicketRequest) -> str:
        """Draw a ticket for a client.

        Raises:
            NotACommandError: too many clients.
        """
        word = self._tickets.draw(request.sender)
        if word is None:
            raise NotACommandError(RefusalReason.INTERNAL, "too many clients have a ticket: end some, or wait")
        return word

    def command(self, asked: str, key: str, payload: bytes, model: type[CommandT]) -> CommandT:
        """Read a start or a reset.

        Args:
            asked: key expression of the query.
            key: the command's own key.
            payload: what it carries.
            model: the command's type.

        Raises:
            NotACommandError: it is none; the journal has a line.
        """
        with self._telling(f"refused a command at {_quoted(asked)}"):
            envelope = self._admit(asked, key, payload, Envelope[model])
        return _signed(envelope.request, envelope.sender)

    def stop(self, asked: str, key: str, payload: bytes) -> StopRequest:
        """Read a stop. It is refused only if it does not name its own key, is empty, or is provably a copy or forged.

        A stop that cannot be read stops. So does one whose ticket is unknown: the control process may have been
        restarted since.

        Args:
            asked: key expression of the query.
            key: the stop's own key.
            payload: what it carries.

        Raises:
            NotACommandError: it is none; the journal has a line.
        """
        with self._telling(f"refused a stop at {_quoted(asked)}"):
            _check_address(asked, key, payload)
            try:
                envelope = Envelope[StopRequest].model_validate_json(payload)
            except ValidationError:
                return StopRequest(reason="the request could not be read")
            if envelope.ticket is not None:
                _check_use(self._tickets.use(envelope.ticket, envelope.sender, envelope.number), envelope.sender)
        return _signed(envelope.request, envelope.sender)

    def presence(self, heard: str, key: str, payload: bytes) -> bool:
        """Return whether a publication is a client's sign of presence; what is none gets a line in the journal."""
        try:
            with self._telling(f"ignored a sign of presence at {_quoted(heard)}"):
                self._admit(heard, key, payload, Envelope[Presence])
        except NotACommandError:
            return False
        return True

    @contextmanager
    def _telling(self, what: str) -> Generator[None]:
        try:
            yield
        except NotACommandError as error:
            self._tell(f"{what}: {error}")
            raise

    def _admit(
        self, asked: str, key: str, payload: bytes, envelope_type: type[Envelope[RequestT]]
    ) -> Envelope[RequestT]:
        _check_address(asked, key, payload)
        envelope = read(payload, envelope_type)
        if envelope.ticket is None:
            raise NotACommandError(RefusalReason.UNKNOWN_SENDER, "it has no ticket: ask query/ticket for one", "ticket")
        use = self._tickets.use(envelope.ticket, envelope.sender, envelope.number)
        if use is Use.UNKNOWN:
            text = f"this control process drew no such ticket for {_quoted(envelope.sender)}: ask query/ticket for one"
            raise NotACommandError(RefusalReason.UNKNOWN_SENDER, text, "ticket")
        _check_use(use, envelope.sender)
        return envelope


def read(payload: bytes, model: type[RequestT]) -> RequestT:
    """Read a message.

    Raises:
        NotACommandError: it does not follow its schema; the text names the first field that is wrong.
    """
    try:
        return model.model_validate_json(payload)
    except ValidationError as error:
        first = error.errors()[0]
        location = [str(part) for part in first["loc"]]
        field = ".".join(location[1:] if location[:1] == ["request"] else location)
        raise NotACommandError(RefusalReason.INVALID_REQUEST, f"{field}: {first['msg']}", field) from error


def _check_address(asked: str, key: str, payload: bytes) -> None:
    if asked != key:
        raise NotACommandError(RefusalReason.INVALID_REQUEST, f"a command names its own key, {key}; a wildcard reads")
    if not payload:
        raise NotACommandError(
            RefusalReason.INVALID_REQUEST, f"it is empty; a command is an envelope of schema {ENVELOPE_VERSION}"
        )


def _check_use(use: Use, sender: str) -> None:
    if use is Use.SPENT:
        raise NotACommandError(RefusalReason.REPLAYED, f"its number was used before by {_quoted(sender)}", "number")
    if use is Use.FORGED:
        text = f"its ticket was not drawn for {_quoted(sender)}"
        raise NotACommandError(RefusalReason.UNKNOWN_SENDER, text, "sender")


def _signed(request: CommandT, sender: str) -> CommandT:
    return request if request.requested_by else request.model_copy(update={"requested_by": sender})


def _quoted(text: str) -> str:
    return ascii(text[:_QUOTED])
