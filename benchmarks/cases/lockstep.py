"""Speed of simulated time relative to the wall clock when the client advances it."""

import time
from collections.abc import Callable

import numpy as np

from benchmarks.harness.exchange import answer, until_answered
from benchmarks.harness.processes import free_port, running
from benchmarks.harness.result import Figure, Result, median
from service.drivers.base import PoseTarget
from service.drivers.sim_wire import CommandWriter
from service.drivers.world_hold import WorldHold
from service.program import MODULE
from sim_backend.zenoh_cell.cell import SimulatedCell
from wire import keys, records
from wire.law import ComplianceLaw, ControlLimits
from wire.records import TICK_S
from wire.session import close_session, open_session
from wire.task import Task

WORLD = "bench"
POLICY_TICKS = 40
LAW = ComplianceLaw(
    stiffness=(1000.0, 1000.0, 1000.0, 10.0, 10.0, 10.0),
    damping=(200.0, 200.0, 200.0, 2.0, 2.0, 2.0),
    inertia=(5.0, 5.0, 5.0, 0.05, 0.05, 0.05),
)
LIMITS = ControlLimits(
    workspace=((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)),
    force_ceiling_n=30.0,
    max_speed=(0.1, 0.5),
    max_step=(0.01, 0.2),
    target_age_s=1.0,
)


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the 20 s of simulated time per row."""
    ticks = max(10, int(10_000 * scale) // POLICY_TICKS) * POLICY_TICKS
    rows = [("world in this process, arm engaged", 1, _in_process(ticks))]
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with running(MODULE, "sim", "serve", "--world", WORLD, "--mode", "lockstep", "--listen", endpoint):
        session = open_session(connect=[endpoint])
        try:
            hold = WorldHold(WORLD, WORLD, "")
            until_answered(session, keys.INFO.format(world=WORLD))
            hold.granted(answer(session, hold.selector, hold.claimant))
            commands = CommandWriter()  # one for both rows: the world takes no number twice
            commands.client = hold.word
            for each in (1, POLICY_TICKS):

                def advance(payload: bytes | None, each: int = each) -> bytes:
                    return answer(session, hold.signed(keys.ADVANCE, f"ticks={each}"), payload)

                rows.append(("world over Zenoh, arm engaged", each, _time(ticks, each, advance, commands)))
        finally:
            close_session(session)
    speeds = [each * TICK_S / span for _, each, span in rows]
    return Result(
        question="How fast is lockstep simulation beside real time?",
        columns=("simulation", "ticks per exchange", "µs per tick", "times real time"),
        rows=tuple(
            (name, str(each), f"{span / each * 1e6:.0f}", f"{speed:.1f}")
            for (name, each, span), speed in zip(rows, speeds, strict=True)
        ),
        finding=f"One tick per exchange over Zenoh, as the service does it, runs at {speeds[1] / speeds[0]:.0%} "
        "of the speed without transport.",
        figures=(
            Figure("tick of the world in this process", rows[0][2] * 1e6, "µs", 25.0),
            Figure("lockstep over Zenoh to no transport", speeds[1] / speeds[0], "of the speed", 0.5, at_least=True),
        ),
        method=f"{ticks * TICK_S:.0f} s of simulated time per row, median exchange; "
        f"a new target every {POLICY_TICKS} ticks.",
    )


def _in_process(ticks: int) -> float:
    cell = SimulatedCell()
    cell.reset(Task(0))

    def advance(commands: bytes | None) -> bytes:
        if commands:
            for command in records.decode(commands, records.COMMAND):
                cell.apply(command)
        return cell.tick().tobytes()

    return _time(ticks, 1, advance, CommandWriter())


def _time(ticks: int, each: int, advance: Callable[[bytes | None], bytes], commands: CommandWriter) -> float:
    """Return the median seconds per call while `ticks` pass, `each` per call, with the arm following targets."""
    state = records.decode(advance(None), records.STATE)[-1:]
    commands.epoch = int(state["epoch"][0])
    position, rotvec = state["tcp_position"][0].copy(), state["tcp_rotvec"][0].copy()
    advance(commands.engage(LAW, LIMITS).tobytes())
    spans: list[float] = []
    for done in range(0, ticks, each):
        due = done % POLICY_TICKS < each
        swing = np.array([0.005 * np.sin(done / 500), 0.0, 0.0])
        payload = commands.target(PoseTarget(position + swing, rotvec)).tobytes() if due else None
        begin = time.perf_counter()
        advance(payload)
        spans.append(time.perf_counter() - begin)
    return median(spans)
