"""The driver of a simulated cell over Zenoh, in real time or in lockstep. `wire` defines the keys and records."""

import asyncio
import contextlib
import json
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import zenoh

from service.drivers.base import DriverError, Load, PoseTarget, Sample, SampleSink
from service.drivers.handover import Handover
from service.drivers.sim_wire import CommandWriter, check_task, read_load, read_sample
from service.drivers.world_hold import WorldHold
from service.faults import FaultCode
from service.program import PROGRAM
from wire import keys, records
from wire.arrays import RecordArray
from wire.law import ComplianceLaw, ControlLimits
from wire.modes import TimeMode
from wire.session import QueryRefusedError, call_in_loop, close_session, open_session, query
from wire.task import Task
from wire.tls import Certificates

QUERY_TIMEOUT_S = 2.0
"""Host time for an answer for which the simulator computes at most one tick, s."""
PREPARE_TIMEOUT_S = 30.0
"""Host time for a simulator to lay out, and perhaps to compile, a world, s."""
IDLE_TICKS = 500
"""Ticks in lockstep without a command or an engaged arm, after which time passes no faster than in reality."""


class ZenohSimDriver:
    """One simulated cell behind Zenoh.

    Args:
        world: name of the world in its keys.
        connect: endpoints of its server.
        mode: time mode. In `real_time` the world's time passes by itself; in `lockstep` this driver advances it.
        clock: monotonic clock for arrivals in real time, s.
        cell: id of the cell that claims the world; empty for a program without one.
        certificates: of this process, for a `tls/` or `quic/` endpoint.
    """

    simulated = True
    tick_s = records.TICK_S

    def __init__(
        self,
        world: str,
        connect: Sequence[str],
        mode: TimeMode,
        clock: Callable[[], float] = time.monotonic,
        cell: str = "",
        certificates: Certificates | None = None,
    ) -> None:
        self._certificates = certificates
        self.mode: TimeMode = mode
        self.name = f"simulated cell sim/{world} at {', '.join(connect)}"
        self._world = world
        self._state_key = keys.STATE.format(world=world)
        self._connect = tuple(connect)
        self._host_clock = clock
        self._commands = CommandWriter()
        self._hold = WorldHold(world, self.name, cell)
        self._handover = Handover()
        self._sending = threading.Lock()
        self._overloaded = False
        self._session: zenoh.Session | None = None
        self._publisher: zenoh.Publisher | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._sink: SampleSink | None = None
        self._newest_seq = -1
        self._arrived = asyncio.Event()
        self._pending: list[RecordArray] = []
        self._ticks = 0
        self._quiet_ticks = 0
        self._task: asyncio.Task[None] | None = None
        self._holding: asyncio.Task[None] | None = None

    @property
    def clock(self) -> Callable[[], float]:
        if self.mode == "lockstep":
            return lambda: self._ticks * records.TICK_S
        return self._host_clock

    @property
    def samples_dropped(self) -> int:
        return self._handover.dropped

    async def connect(self, sink: SampleSink) -> None:
        self._sink = sink
        self._loop = asyncio.get_running_loop()
        if self._session is None:
            self._session = await asyncio.to_thread(open_session, (), self._connect, self._certificates)
        info = await self._ask_info(self._session)
        await self._hold.claim(self._session)
        self._commands.epoch, self._commands.client = int(info["epoch"]), self._hold.word
        if self._holding is None or self._holding.done():
            self._holding = asyncio.create_task(self._keep_hold(self._session), name="hold")
        if self.mode == "lockstep":
            if self._task is None or self._task.done():
                self._task = asyncio.create_task(self._let_time_pass(), name="lockstep")
        elif self._publisher is None:
            self._publisher = self._session.declare_publisher(
                keys.COMMAND.format(world=self._world),
                congestion_control=zenoh.CongestionControl.DROP,  # a late command is worth nothing
                priority=zenoh.Priority.REAL_TIME,
                express=True,
            )
            self._session.declare_subscriber(self._state_key, self._receive)

    async def prepare(self, task: Task | None) -> None:
        payload = json.dumps(check_task(task).to_json()).encode()
        replies = await self._query(self._hold.signed(keys.RESET), payload, PREPARE_TIMEOUT_S)
        try:
            laid_out = int(records.decode(replies[0], records.STATE)[0]["seq"])
        except records.WireError as error:
            raise DriverError(FaultCode.PROTOCOL, f"{self.name}: {error}") from error
        self._quiet_ticks = 0
        self._overloaded = False
        try:
            async with asyncio.timeout(QUERY_TIMEOUT_S):
                while self._newest_seq <= laid_out:
                    self._arrived.clear()
                    await self._arrived.wait()
        except TimeoutError as error:
            raise DriverError(FaultCode.STALE, f"{self.name}: no samples after the world was laid out") from error

    def engage(self, law: ComplianceLaw, limits: ControlLimits) -> None:
        self._send(partial(self._commands.engage, law, limits), of_run=True)

    def send_target(self, target: PoseTarget) -> int:
        self._send(partial(self._commands.target, target), of_run=True)
        return self._commands.seq

    def stop(self) -> None:
        self._pending = [order for order in self._pending if order[0]["kind"] == records.Kind.STOP_BLIND]
        self._send(self._commands.stop)

    def stop_blind(self) -> None:
        self._pending.clear()
        self._send(partial(self._commands.stop, blind=True))

    def escalate(self) -> None:
        self.stop()

    def zero_ft(self) -> None:
        self._send(self._commands.zero_ft, of_run=True)

    def unlock(self) -> None:
        self._send(self._commands.unlock)

    async def close(self) -> None:
        self.stop()
        tasks = [task for task in (self._task, self._holding) if task is not None]
        self._task = self._holding = None
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        session, self._session, self._publisher = self._session, None, None
        if session is not None:
            if self._pending and self._hold.word:
                payload = b"".join(command.tobytes() for command in self._pending)
                with contextlib.suppress(QueryRefusedError):
                    await query(session, self._hold.signed(keys.ADVANCE, "ticks=1"), payload, QUERY_TIMEOUT_S)
            await self._hold.release(session)
            await asyncio.to_thread(close_session, session)

    # --- real time

    def _receive(self, message: zenoh.Sample) -> None:
        """Check a state against the schema, stamp its arrival and hand it over. Runs on Zenoh's thread."""
        arrival_s = self._host_clock()
        if str(message.key_expr) != self._state_key:
            return  # the world names its key; a wildcard is somebody else's
        state = message.payload.to_bytes()
        failed = False
        try:
            failed = self._stop_overload(read_load(state))
            wake = self._handover.offer(read_sample(state, arrival_s)) or failed
        except records.WireError as error:
            wake = self._handover.report(FaultCode.PROTOCOL, f"{self.name}: {error}") or failed
        if wake and self._loop is not None:
            call_in_loop(self._loop, self._deliver)

    def _stop_overload(self, load: Load) -> bool:
        """Stop the arm where its load demands it, and again while it does not obey. Runs on Zenoh's thread.

        Returns:
            True if the judgement failed and the loop must be woken for it.
        """
        if self._sink is None:
            return False
        try:
            demanded = self._sink.overloads(load)
        except Exception as error:  # whatever it is: the sample still goes to the loop, which stops and latches
            return self._handover.report(FaultCode.INTERNAL, f"{type(error).__name__}: {error}")
        if demanded or (self._overloaded and load.engaged):
            self._overloaded = True
            self._send(self._commands.stop)
        return False

    def _deliver(self) -> None:
        samples, fault = self._handover.take()
        for sample in samples:
            self._hand_on(sample)
        if fault is not None and self._sink is not None:
            self._sink.on_link_fault(*fault)

    # --- lockstep

    async def _let_time_pass(self) -> None:
        while True:
            commands, self._pending = self._pending, []
            try:
                payload = b"".join(command.tobytes() for command in commands)
                replies = await self._query(self._hold.signed(keys.ADVANCE, "ticks=1"), payload, QUERY_TIMEOUT_S)
                states = records.decode(replies[0], records.STATE)
                self._ticks += len(states)
                samples = [read_sample(state.tobytes(), self._ticks * records.TICK_S) for state in states]
            except records.WireError as error:
                self._report(FaultCode.PROTOCOL, f"{self.name}: {error}")
                return
            except DriverError as error:
                self._report(error.code, str(error))
                return
            for sample in samples:
                self._hand_on(sample)
            quiet = samples[-1].program is records.Program.IDLE and not self._pending
            self._quiet_ticks = self._quiet_ticks + 1 if quiet else 0
            if self._quiet_ticks > IDLE_TICKS:
                await asyncio.sleep(records.TICK_S)

    # --- both

    async def _keep_hold(self, session: zenoh.Session) -> None:
        try:
            await self._hold.keep(session, self._tell_refused)
        except DriverError as error:  # this process was silent for so long that another cell has the world now
            self._report(FaultCode.LINK, str(error))

    def _tell_refused(self, count: int) -> None:
        if self._sink is not None:
            self._sink.on_notice(f"{self.name} refused {count} commands or requests that were not this cell's")

    def _send(self, write: Callable[[], RecordArray], *, of_run: bool = False) -> None:
        """Write a command and send it, in one step, because the world takes no number below an earlier one.

        Runs on the loop's thread, for a stop on Zenoh's thread too.

        Args:
            write: makes the command.
            of_run: an order that does not leave any more once Zenoh's thread has stopped the run.
        """
        publisher = self._publisher  # `close` may take it away meanwhile
        if self.mode == "lockstep":
            self._pending.append(write())
        elif publisher is not None:
            try:
                with self._sending:
                    if not (of_run and self._overloaded):
                        publisher.put(write().tobytes())
            except zenoh.ZError as error:
                self._report(FaultCode.LINK, f"{self.name}: a command could not be sent: {error}")

    def _hand_on(self, sample: Sample) -> None:
        self._newest_seq = sample.seq
        self._arrived.set()
        if self._sink is not None:
            self._sink.on_sample(sample)

    def _report(self, code: FaultCode, text: str) -> None:
        if self._loop is not None and self._sink is not None:
            call_in_loop(self._loop, self._sink.on_link_fault, code, text)

    async def _ask_info(self, session: zenoh.Session) -> dict[str, Any]:
        replies = await self._query(keys.INFO.format(world=self._world), b"", QUERY_TIMEOUT_S)
        if len(replies) > 1:
            raise DriverError(
                FaultCode.SOURCE, f"{self.name}: {len(replies)} worlds answer to this name; end all but one"
            )
        try:
            info: dict[str, Any] = json.loads(replies[0])
            version, mode = int(info["version"]), str(info["mode"]).replace("-", "_")
            int(info["epoch"])
        except (ValueError, KeyError, TypeError) as error:
            raise DriverError(
                FaultCode.PROTOCOL, f"{self.name}: its answer to `info` cannot be read: {error}"
            ) from error
        if version != records.VERSION:
            own = records.VERSION
            text = f"{self.name} speaks schema version {version}, this side reads {own}; install the same version"
            raise DriverError(FaultCode.PROTOCOL, text)
        if mode != self.mode:
            text = (
                f"{self.name} runs in {mode}, the configuration says {self.mode}: change sim.mode or restart the world"
            )
            raise DriverError(FaultCode.PROTOCOL, text)
        return info

    async def _query(self, selector: str, payload: bytes, timeout_s: float) -> list[bytes]:
        if self._session is None:
            raise DriverError(FaultCode.LINK, f"{self.name}: not connected")
        try:
            replies = await query(self._session, selector, payload, timeout_s)
        except QueryRefusedError as error:
            raise DriverError(FaultCode.PROTOCOL, f"{self.name} refused: {error}") from error
        if not replies:
            raise DriverError(FaultCode.LINK, f"{self.name} does not answer: is `{PROGRAM} sim serve` running?")
        return replies
