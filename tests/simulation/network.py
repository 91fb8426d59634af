"""A simulated Zenoh: the sessions that the code uses, on links that delay, drop, repeat, reorder and stall messages."""

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import zenoh

from tests.simulation import clock
from tests.simulation.clock import Place, Process, VirtualLoop
from tests.simulation.threads import SimpleQueue


class Payload:
    """Stands in for `zenoh.ZBytes`."""

    __slots__ = ("_content",)

    def __init__(self, content: bytes) -> None:
        self._content = bytes(content)

    def to_bytes(self) -> bytes:
        return self._content

    def to_string(self) -> str:
        return self._content.decode()

    def __bytes__(self) -> bytes:
        return self._content


def _payload(content: Any) -> Payload | None:
    if content is None:
        return None
    return Payload(content.encode() if isinstance(content, str) else bytes(content))


@dataclass(slots=True)
class Sample:
    """Stands in for `zenoh.Sample`."""

    key_expr: Any
    payload: Any
    attachment: Payload | None = None


@dataclass(slots=True)
class ReplyError:
    """Stands in for `zenoh.ReplyError`."""

    payload: Any


@dataclass(slots=True)
class Reply:
    """Stands in for `zenoh.Reply`."""

    ok: Sample | None = None
    err: ReplyError | None = None


@lru_cache(maxsize=4096)
def _meets(one: str, other: str) -> bool:
    return zenoh.KeyExpr(one).intersects(zenoh.KeyExpr(other))


@dataclass
class Link:
    """One direction between two processes: a stream in order, unless a fault is set.

    Attributes:
        delay_s: least and largest delay of a message.
        drop: share of the publications that are lost.
        repeat: share of the publications that arrive twice.
        reorder: messages do not wait for earlier ones.
        stalled_until: nothing arrives before; then everything does, in order.
        cut_until: what is sent before is lost.
    """

    delay_s: tuple[float, float] = (5e-5, 4e-4)
    drop: float = 0.0
    repeat: float = 0.0
    reorder: bool = False
    stalled_until: float = 0.0
    cut_until: float = 0.0
    last_s: float = 0.0


class Network:
    """Every session of one universe. Sessions that name a common endpoint hear each other.

    Attributes:
        heard: key and content of every query, as somebody on the network can record them.
    """

    def __init__(self, loop: VirtualLoop, chance: random.Random) -> None:
        self.loop = loop
        self.chance = chance
        self.sessions: list[Session] = []
        self.links: dict[tuple[str, str], Link] = {}
        self.heard: list[tuple[str, bytes]] = []
        self.sent = 0

    def link(self, source: str, target: str) -> Link:
        """The link from one process to another, by their names."""
        found = self.links.get((source, target))
        if found is None:
            found = self.links[source, target] = Link()
        return found

    def carry(self, source: Process, place: Place, droppable: bool, deliver: Callable[..., object], *args: Any) -> None:
        """Let a message from `source` arrive at `place`."""
        link = self.link(source.name, place.process.name)
        loop, chance = self.loop, self.chance
        now = loop.time()
        self.sent += 1
        if now < link.cut_until or (droppable and link.drop and chance.random() < link.drop):
            return
        low, high = link.delay_s
        for _ in range(2 if droppable and link.repeat and chance.random() < link.repeat else 1):
            at_s = max(now + low + (high - low) * chance.random(), link.stalled_until)
            if not link.reorder:
                at_s = link.last_s = max(at_s, link.last_s)
            loop.call_at(at_s, deliver, *args, context=place.context.copy())

    def open(self, listen: Sequence[str] = (), connect: Sequence[str] = (), *_: Any, **__: Any) -> "Session":
        """Stand in for `wire.session.open_session`."""
        process = clock.here().process
        session = Session(self, process, frozenset((*listen, *connect)))
        self.sessions.append(session)
        process.on_kill.append(session.close)
        return session

    def has_listener(self, endpoint: str) -> bool:
        """Stand in for `wire.endpoints.has_listener`, for the endpoint of a control process."""
        return any(session.process.name == "control" and endpoint in session.endpoints for session in self.sessions)

    def peers(self, session: "Session") -> list["Session"]:
        return [other for other in self.sessions if other is not session and other.endpoints & session.endpoints]


class Channel(SimpleQueue):
    """Stands in for the receiving end of a `zenoh.handlers.FifoChannel`."""

    def try_recv(self) -> Any:
        return None if self.empty() else self.get_nowait()

    def recv(self) -> Any:
        return self.get()


@dataclass(eq=False)
class Declared:
    """A subscriber or queryable; with a channel it is also what the code receives from."""

    session: "Session"
    key: str
    call: Callable[[Any], object]
    channel: Channel | None = None
    where: list["Declared"] = field(default_factory=list)

    def undeclare(self) -> None:
        if self in self.where:
            self.where.remove(self)

    def try_recv(self) -> Any:
        assert self.channel is not None
        return self.channel.try_recv()

    def recv(self) -> Any:
        assert self.channel is not None
        return self.channel.recv()


class Publisher:
    """Stands in for `zenoh.Publisher`."""

    def __init__(self, session: "Session", key: str) -> None:
        self._session, self._key = session, key

    def put(self, payload: Any, *, attachment: Any = None, **_: Any) -> None:
        self._session.put(self._key, payload, attachment=attachment)

    def undeclare(self) -> None: ...


class Session:
    """Stands in for `zenoh.Session`."""

    def __init__(self, network: Network, process: Process, endpoints: frozenset[str]) -> None:
        self.network, self.process, self.endpoints = network, process, endpoints
        self.place = Place(process, "zenoh")
        self.subscribers: list[Declared] = []
        self.queryables: list[Declared] = []
        self.asked: list[Asked] = []
        self.closed = False

    def declare_publisher(self, key: Any, **_: Any) -> Publisher:
        return Publisher(self, str(key))

    def declare_subscriber(self, key: Any, handler: Any = None, **_: Any) -> Declared:
        return self._declare(self.subscribers, key, handler)

    def declare_queryable(self, key: Any, handler: Any = None, **_: Any) -> Declared:
        return self._declare(self.queryables, key, handler)

    def put(self, key: Any, payload: Any, *, attachment: Any = None, **_: Any) -> None:
        if self.closed:
            return
        content, note = _payload(payload), _payload(attachment)
        for peer in self.network.peers(self):
            for subscriber in peer.subscribers:
                if _meets(str(key), subscriber.key):
                    sample = Sample(key, content, note)
                    self.network.carry(self.process, peer.place, True, peer.deliver, subscriber.call, sample)

    def get(
        self,
        selector: Any,
        handler: Any,
        *,
        payload: Any = None,
        timeout: float = 10.0,
        attachment: Any = None,
        **_: Any,
    ) -> None:
        key, _separator, parameters = str(selector).partition("?")
        asked = Asked(self, handler.callback, handler.drop)
        if self.closed:
            asked.finish()
            return
        self.asked.append(asked)
        if payload:
            self.network.heard.append((key, bytes(payload)))
        self.network.loop.call_later(timeout, asked.time_out, context=self.place.context.copy())
        for peer in self.network.peers(self):
            for queryable in peer.queryables:
                if _meets(key, queryable.key):
                    query = Query(asked, peer, key, parameters, _payload(payload), _payload(attachment))
                    asked.open.append(query)
                    self.network.carry(self.process, peer.place, False, peer.deliver, queryable.call, query)
        if not asked.open:
            self.network.loop.call_soon(asked.finish, context=self.place.context.copy())

    def deliver(self, call: Callable[[Any], object], item: Any) -> None:
        if not self.closed:
            call(item)

    def close(self) -> None:
        self.closed = True
        if self in self.network.sessions:
            self.network.sessions.remove(self)
        for peer in self.network.sessions:  # whoever waits for an answer from here gets none
            for asked in list(peer.asked):
                for query in [query for query in asked.open if query.peer is self]:
                    self.network.carry(self.process, peer.place, False, asked.close, query)
        for asked in list(self.asked):
            asked.finish()

    def is_closed(self) -> bool:
        return self.closed

    def _declare(self, where: list[Declared], key: Any, handler: Any) -> Declared:
        if isinstance(handler, zenoh.handlers.FifoChannel):
            channel = Channel()
            declared = Declared(self, str(key), channel.put, channel, where)
        else:
            declared = Declared(self, str(key), handler, None, where)
        where.append(declared)
        return declared


class Asked:
    """One `get`, until every queryable has answered or time is up."""

    def __init__(self, session: Session, callback: Callable[[Any], object], drop: Callable[[], object]) -> None:
        self.session, self._callback, self._drop = session, callback, drop
        self.open: list[Query] = []
        self.finished = False

    def conclude(self, query: "Query", replies: list[Reply]) -> None:
        for reply in replies:
            if not self.finished:
                self._callback(reply)
        self.close(query)

    def close(self, query: "Query") -> None:
        if query in self.open:
            self.open.remove(query)
        if not self.open:
            self.finish()

    def time_out(self) -> None:
        if not self.finished:
            self._callback(Reply(err=ReplyError(Payload(b"Timeout"))))
            self.finish()

    def finish(self) -> None:
        if not self.finished:
            self.finished = True
            if self in self.session.asked:
                self.session.asked.remove(self)
            self._drop()


class Query:
    """Stands in for `zenoh.Query`."""

    def __init__(
        self, asked: Asked, peer: Session, key: str, parameters: str, payload: Payload | None, note: Payload | None
    ) -> None:
        self._asked, self.peer = asked, peer
        self.key_expr = zenoh.KeyExpr(key)
        self.selector = f"{key}?{parameters}" if parameters else key
        self.parameters = parameters
        self.payload = payload
        self.attachment = note
        self._replies: list[Reply] = []

    def __enter__(self) -> "Query":
        return self

    def __exit__(self, *_: object) -> None:
        self.drop()

    def reply(self, key_expr: Any, payload: Any, *, attachment: Any = None, **_: Any) -> None:
        self._replies.append(Reply(ok=Sample(key_expr, _payload(payload), _payload(attachment))))

    def reply_err(self, payload: Any, **_: Any) -> None:
        self._replies.append(Reply(err=ReplyError(_payload(payload))))

    def drop(self) -> None:
        """Send what was answered, and that no more comes: in one message, which no fault of a link takes apart."""
        session = self._asked.session
        if not self.peer.closed:
            session.network.carry(self.peer.process, session.place, False, self._asked.conclude, self, self._replies)


def close_session(session: Session) -> None:
    """Stand in for `wire.session.close_session`."""
    session.close()
