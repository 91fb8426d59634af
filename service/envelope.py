"""The envelope of a command to a cell: its sender, and a nonce that is good for one use.

A client asks for a ticket (`query/ticket`), a random word that the control process draws for it, and numbers what it
sends under that ticket. Ticket and number together are the nonce. A command without an envelope is refused, except a
stop, which `docs/reference/wire-security.md` explains.
"""

from typing import Annotated, Generic, Literal, TypeVar

from pydantic import Field, TypeAdapter

from service.messages import Message, Refused

ENVELOPE_VERSION = 1
QUERY_TICKET = "cell/{cell}/query/ticket"
TICKET_IDLE_S = 30.0
"""Silence of a client after which its ticket may be withdrawn, s."""

RequestT = TypeVar("RequestT", bound=Message)
Sender = Annotated[str, Field(min_length=1, max_length=128)]
Ticket = Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]


class Envelope(Message, Generic[RequestT]):
    """A command on its way to a cell.

    Attributes:
        schema_version: of this envelope.
        sender: name under which the ticket was drawn; it stands in the record where the request names nobody.
        ticket: from `query/ticket`; None only for a stop that cannot wait for one.
        number: good for one use under this ticket.
        request: the command itself.
    """

    schema_version: Literal[1]
    sender: Sender
    ticket: Ticket | None
    number: Annotated[int, Field(ge=1, lt=2**53)]
    request: RequestT


class Presence(Message):
    """A client's sign of presence; it has no content."""


class TicketRequest(Message):
    """Ask for a ticket."""

    sender: Sender


class TicketResult(Message):
    """A ticket of the control process `service_epoch`; no other process knows it."""

    kind: Literal["ticket"] = "ticket"
    ticket: Ticket
    service_epoch: str


TICKET_ANSWER: TypeAdapter[TicketResult | Refused] = TypeAdapter(
    Annotated[TicketResult | Refused, Field(discriminator="kind")]
)
