"""Time from a UR controller's package with a force above the ceiling to the stop order, between real processes."""

import asyncio
import random
import socket
from collections.abc import Callable

from benchmarks.cases.stop_latency import stops
from benchmarks.harness import operating
from benchmarks.harness.exchange import spans
from benchmarks.harness.processes import free_port, running
from benchmarks.harness.result import QUANTILES, Result, median, quantile_figures, quantiles
from benchmarks.stands.tripping_world import FORCE_N
from benchmarks.stands.ur_cell import HOST, controller_options, shipped_ur_cell
from service.client import CellClient
from service.drivers.ur.samples import OUTPUTS
from service.program import MODULE
from wire.rtde import fields
from wire.rtde.codec import HEADER_SIZE, Recipe
from wire.rtde.messages import PORT


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the 40 stops per row and the 2000 echoes."""
    size = HEADER_SIZE + Recipe(OUTPUTS, [fields.OUTPUTS[name] for name in OUTPUTS], 1).size
    echo = _echo(size, max(100, int(2000 * scale)))
    rows = [("bare TCP echo: there and back", echo)]
    for name, realtime in (("asked for", "true"), ("not asked for", "false")):
        rows.append((f"at the socket, real-time scheduling {name}", _stops(realtime, max(5, int(40 * scale)))))
    reference, taken_s = median(echo), median(rows[1][1])
    return Result(
        question="How long from a package above the ceiling to the stop order, for a UR arm?",
        columns=("way", "stops", *(f"{name} µs" for name in QUANTILES), "to echo"),
        rows=tuple(
            (name, str(len(taken)), *quantiles(taken), f"{median(taken) / reference:.1f}") for name, taken in rows
        ),
        finding=f"At the controller's socket {taken_s * 1e6:.0f} µs (median), {taken_s / reference:.1f} bare echoes; "
        "the control program on the controller does not wait for this order.",
        figures=quantile_figures("over ceiling to stop at the socket", rows[1][1], {"p50": 250.0, "p99": 1000.0}),
        method="Control process, emulated controller and between them a relay of RTDE, in real time. While the control "
        f"process approaches, the relay sends one package of {FORCE_N:g} N, and times the arrival of the stop order in "
        "the input registers, both at its own socket. The arm's own law is not affected. The echo has as many bytes as "
        f"a package, {size}. Runs that ended earlier are excluded.",
    )


def _stops(realtime: str, count: int) -> list[float]:
    relay, trips = free_port(), f"tcp/127.0.0.1:{free_port()}"
    with shipped_ur_cell(ur__rtde_port=str(relay), cell__realtime=realtime) as shipped:
        output = str(shipped.config.cell.state_dir / "watched.npz")
        service = "benchmarks.stands.watched_service", output
        with (
            running(MODULE, "sim", *controller_options(shipped)),
            running("benchmarks.stands.lying_relay", HOST, str(relay), str(PORT), trips),
            running(*service, ready="serving", environment=shipped.environment),
        ):
            return asyncio.run(stops(shipped, trips, count, _approach))


async def _approach(client: CellClient, recipe: str, seed: int) -> bool:
    """Wait for the approach, and for any moment of a tick."""
    if not await operating.approach(client, recipe, seed):
        return False
    await asyncio.sleep(random.uniform(0.0, 0.2))  # noqa: S311  # any draw will do
    return True


def _echo(size: int, count: int) -> list[float]:
    port = free_port()
    with running("benchmarks.stands.tcp_echo", str(port)), socket.create_connection(("127.0.0.1", port)) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return spans(count, _exchange(connection, bytes(size)))


def _exchange(connection: socket.socket, payload: bytes) -> Callable[[], object]:
    def exchange() -> None:
        connection.sendall(payload)
        connection.recv(len(payload), socket.MSG_WAITALL)

    return exchange
