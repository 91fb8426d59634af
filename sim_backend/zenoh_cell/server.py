"""One simulated cell on a Zenoh session: a single thread owns the world, all messages are queued to it.

Zenoh's own threads only fill bounded channels and never touch the world. A full channel blocks its sender.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any, NoReturn

import numpy.typing as npt
import zenoh

from sim_backend.holding import Holding
from sim_backend.metronome import Metronome
from sim_backend.requests import RequestError, asked, query_keys
from sim_backend.zenoh_cell import answers
from sim_backend.zenoh_cell.cell import SimulatedCell
from sim_backend.zenoh_cell.rest import Rest
from wire import keys, records
from wire.realtime import settle_interpreter

_QUERY_CAPACITY = 64
_COMMAND_CAPACITY = 256
MAX_COMMANDS_PER_TICK = 32
"""Commands that one tick applies; if more arrive, the newest are kept. STOP is never dropped."""

_QUERIES = {
    "advance": keys.ADVANCE, "reset": keys.RESET, "claim": keys.CLAIM, "release": keys.RELEASE,
    "info": keys.INFO, "truth": keys.TRUTH,
}  # fmt: skip
_READINGS = ("info", "truth")


class Pace(StrEnum):
    """Clock of a simulated world: the wall clock, or its client's requests."""

    REAL_TIME = "real-time"
    LOCKSTEP = "lockstep"


@dataclass(slots=True)
class Counters:
    """Counts of messages and ticks since the start; part of the answer to `info`."""

    ticks: int = 0
    overruns: int = 0
    skipped: int = 0
    worst_lateness_s: float = 0.0
    commands: int = 0
    commands_malformed: int = 0
    commands_dropped: int = 0
    commands_refused: int = 0
    queries_refused: int = 0


class Server:
    """Serves one world under `sim/<world>/`; the thread that calls `run` owns the cell."""

    def __init__(
        self, cell: SimulatedCell, session: zenoh.Session, world: str, mode: Pace, degraded: Sequence[str] = ()
    ) -> None:
        """Declare the keys.

        Args:
            cell: world, laid out.
            session: open session; the caller closes it after `run`.
            world: name of the world in its keys.
            mode: clock of the world.
            degraded: grants that the host refused, for `info`.

        Raises:
            ValueError: a key cannot contain `world`.
        """
        self.counters = Counters()
        self._cell = cell
        self._holding = Holding()
        self._command_key = keys.COMMAND.format(world=world)
        self._mode = mode
        self._degraded = list(degraded)
        self._keys = query_keys(world, _QUERIES)
        self._queries = session.declare_queryable(f"sim/{world}/*", zenoh.handlers.FifoChannel(_QUERY_CAPACITY))
        if mode is Pace.REAL_TIME:
            self._commands = session.declare_subscriber(
                self._command_key, zenoh.handlers.FifoChannel(_COMMAND_CAPACITY)
            )
            self._state = session.declare_publisher(
                keys.STATE.format(world=world),
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
            )

    def run(self) -> NoReturn:
        """Serve until an exception such as a signal handler's SystemExit; nothing is served afterwards."""
        try:
            if self._mode is Pace.REAL_TIME:
                self._run_in_real_time()
            while True:
                self._answer(self._queries.recv())
        finally:
            # A Zenoh thread that waits at a full channel would delay the end of the session by ten seconds.
            self._queries.undeclare()
            if self._mode is Pace.REAL_TIME:
                self._commands.undeclare()

    def _run_in_real_time(self) -> NoReturn:
        settle_interpreter()
        metronome = Metronome(records.TICK_S)
        rest = Rest()
        while True:
            metronome.wait(rest.ticks)
            commands = self._take_commands()
            for command in commands:
                answers.apply(self._cell, self._holding, command)
            state = self._cell.tick(rest.ticks)
            self._state.put(state.tobytes())
            self.counters.ticks += 1
            self.counters.overruns = metronome.overruns
            self.counters.skipped = metronome.skipped
            self.counters.worst_lateness_s = metronome.worst_lateness_s
            query = self._queries.try_recv()
            laid_out = query is not None and self._answer(query)
            if laid_out:
                metronome.restart()
            busy = int(state["program"][0]) != records.Program.IDLE  # a protective stop is timed in ticks
            rest.note(disturbed=bool(commands) or laid_out or busy)

    def _take_commands(self) -> list[npt.NDArray[Any]]:
        """Return the commands since the last tick: stops first, then those after the last stop, in order."""
        stops: list[npt.NDArray[Any]] = []
        others: list[npt.NDArray[Any]] = []
        for _ in range(_COMMAND_CAPACITY):
            sample = self._commands.try_recv()
            if sample is None:
                break
            if str(sample.key_expr) != self._command_key:
                self._holding.refused += 1  # a wildcard reaches many worlds and commands none
                continue
            try:
                commands = answers.read_commands(sample.payload.to_bytes())
            except records.WireError:
                self.counters.commands_malformed += 1
                continue
            for command in commands:
                if command["kind"] in (records.Kind.STOP, records.Kind.STOP_BLIND):
                    self.counters.commands_dropped += len(others)
                    others.clear()
                    stops.append(command)
                else:
                    others.append(command)
        kept = stops[-MAX_COMMANDS_PER_TICK:] + others[-MAX_COMMANDS_PER_TICK:]
        self.counters.commands += len(kept)
        self.counters.commands_dropped += len(stops) + len(others) - len(kept)
        return kept

    def _answer(self, query: zenoh.Query) -> bool:
        """Reply to one query; return True if it laid out the world, which takes longer than a tick."""
        with query:
            try:
                name = asked(query, self._keys, _READINGS)
                reply = self._carry_out(name, query)
            except RequestError as error:
                self.counters.queries_refused += 1
                query.reply_err(str(error), encoding=zenoh.Encoding.TEXT_PLAIN)
                return False
            query.reply(self._keys[name], reply, express=True)
            return name == "reset"

    def _carry_out(self, name: str, query: zenoh.Query) -> bytes:
        payload = query.payload.to_bytes() if query.payload is not None else b""
        if name == "truth":
            return answers.truth(self._cell)
        if name == "info":
            return self._info()
        parameters = str(query.parameters)
        if name == "claim":
            return self._holding.claim(parameters, payload)
        if name == "release":
            self._holding.release(parameters)
            return b""
        if name == "reset":
            reply = answers.reset(self._cell, self._holding, parameters, payload)
            if self._mode is Pace.REAL_TIME:
                self.counters.commands_dropped += len(self._take_commands())  # meant for the episode that ends here
            return reply
        if self._mode is Pace.REAL_TIME:
            raise RequestError("advance: this world runs in real time; only a lockstep world is advanced by its client")
        reply = answers.advance(self._cell, self._holding, parameters, payload)
        self.counters.ticks += len(reply) // records.STATE.itemsize
        self.counters.commands += len(payload) // records.COMMAND.itemsize
        return reply

    def _info(self) -> bytes:
        self.counters.commands_refused = self._holding.refused
        document = {
            "version": records.VERSION,
            "mode": self._mode,
            "epoch": self._cell.epoch,
            "tick_s": records.TICK_S,
            "part": self._cell.part,
            "degraded": self._degraded,
            "holder": self._holding.described(),
            "counters": asdict(self.counters),
        }
        return json.dumps(document).encode()
