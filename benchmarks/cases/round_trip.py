"""A state of the simulated cell over Zenoh, beside the bare transport and the bare physics."""

import queue
import time
from collections.abc import Callable

import zenoh

from benchmarks.harness.exchange import TIMEOUT_S, answer, spans, until_answered
from benchmarks.harness.processes import free_port, running
from benchmarks.harness.result import QUANTILES, Figure, Result, median, quantiles
from benchmarks.stands.echo import ASK, PING, PONG
from service.drivers.world_hold import WorldHold
from service.program import MODULE
from sim_backend.zenoh_cell.cell import SimulatedCell
from wire import keys
from wire.records import STATE, Kind, new
from wire.session import close_session, open_session
from wire.task import Task

WORLD = "bench"


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the 2000 exchanges per row."""
    count = max(50, int(2000 * scale))
    payload = new(STATE, Kind.STATE).tobytes()
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with running("benchmarks.stands.echo", endpoint):
        session = open_session(connect=[endpoint])
        try:
            echo = spans(count, publication_echo(session, payload))
            until_answered(session, ASK, payload)
            asked = spans(count, lambda: answer(session, ASK, payload))
        finally:
            close_session(session)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with running(MODULE, "sim", "serve", "--world", WORLD, "--mode", "lockstep", "--listen", endpoint):
        session = open_session(connect=[endpoint])
        try:
            hold = WorldHold(WORLD, WORLD, "")
            until_answered(session, keys.INFO.format(world=WORLD))
            hold.granted(answer(session, hold.selector, hold.claimant))
            advanced = spans(count, lambda: answer(session, hold.signed(keys.ADVANCE, "ticks=1")))
        finally:
            close_session(session)
    cell = SimulatedCell()
    cell.reset(Task(0))
    physics = spans(count, lambda: cell.tick().tobytes())
    rows = (
        ("bare publication, there and back", *quantiles(echo), f"{median(echo) / median(asked):.2f}"),
        ("bare query", *quantiles(asked), "1.00"),
        ("cell: one lockstep tick by query", *quantiles(advanced), f"{median(advanced) / median(asked):.2f}"),
        ("cell: the same tick in this process", *quantiles(physics), f"{median(physics) / median(asked):.2f}"),
    )
    over = median(advanced) - median(asked) - median(physics)
    return Result(
        question="What does a state over Zenoh cost beside a bare echo?",
        columns=("exchange", *(f"{name} µs" for name in QUANTILES), "to bare query"),
        rows=rows,
        finding=f"A lockstep tick costs a bare query, the tick itself, and {over * 1e6:.0f} µs more (medians).",
        figures=(Figure("lockstep tick to bare query", median(advanced) / median(asked), "times", 1.5),),
        method=f"{count} exchanges per row, one at a time, of {len(payload)} bytes, between two processes "
        "over TCP on loopback.",
    )


def publication_echo(session: zenoh.Session, payload: bytes) -> Callable[[], object]:
    """Return an exchange with `benchmarks.stands.echo` after both sides have discovered each other."""
    arrived: queue.SimpleQueue[None] = queue.SimpleQueue()

    def back(_: zenoh.Sample) -> None:
        arrived.put(None)

    session.declare_subscriber(PONG, back)
    ping = session.declare_publisher(
        PING, congestion_control=zenoh.CongestionControl.DROP, priority=zenoh.Priority.REAL_TIME, express=True
    )
    while arrived.empty():  # until both sides have discovered each other
        ping.put(payload)
        time.sleep(0.05)
    time.sleep(0.2)
    while not arrived.empty():
        arrived.get()

    def exchange() -> None:
        ping.put(payload)
        arrived.get(timeout=TIMEOUT_S)

    return exchange
