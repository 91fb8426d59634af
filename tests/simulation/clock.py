"""One virtual clock for many simulated processes: an event loop whose time jumps, and threads that are greenlets.

Every callback belongs to a *place*: the event loop of a process, or one of its threads. The places take turns in an
order drawn from the seed. A process can be frozen (SIGSTOP), its loop alone can be blocked, and it can be killed.
"""

import asyncio
import heapq
import itertools
import random
from collections import deque
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from contextvars import Context, ContextVar, copy_context
from typing import Any

import greenlet

PLACE: ContextVar["Place"] = ContextVar("PLACE")
START_S = 1000.0
EXECUTOR_POLL_S = 0.01


class DeadlockError(Exception):
    """Nothing is ready and no timer is set."""


class Place:
    """A sequence of callbacks that run one after another: an event loop's, or a thread's."""

    __slots__ = ("blocked_until", "context", "name", "process", "ready")

    def __init__(self, process: "Process", name: str) -> None:
        self.process = process
        self.name = name
        self.ready: deque[asyncio.Handle] = deque()
        self.blocked_until = 0.0
        self.context = Context()
        self.context.run(PLACE.set, self)

    def awake_at(self) -> float:
        return max(self.blocked_until, self.process.frozen_until)


class Process:
    """A simulated process: a loop, threads, and what it holds of the outside, which a kill takes from it."""

    def __init__(self, loop: "VirtualLoop", name: str) -> None:
        self.loop = loop
        self.name = name
        self.alive = True
        self.frozen_until = 0.0
        self.main = Place(self, "loop")
        self.on_kill: list[Callable[[], None]] = []
        self.executing: list[Thread] = []
        self.signal_handlers: dict[int, Callable[..., object]] = {}

    def spawn(self, work: Coroutine[Any, Any, Any], name: str) -> asyncio.Task[Any]:
        """Start a task on the process's loop."""
        context = self.main.context.copy()
        return self.loop.create_task(work, name=f"{self.name}: {name}", context=context)

    def freeze(self, seconds: float) -> None:
        """Stop the whole process for a while, as SIGSTOP does."""
        self.frozen_until = max(self.frozen_until, self.loop.time() + seconds)

    def block(self, seconds: float) -> None:
        """Hold the event loop for a while, as a handler that computes does. The threads go on."""
        self.main.blocked_until = max(self.main.blocked_until, self.loop.time() + seconds)

    def kill(self) -> None:
        """End it at once, as SIGKILL does."""
        self.alive = False
        for release in self.on_kill:
            release()

    def signal(self, number: int) -> None:
        """Deliver a signal that the process handles on its loop."""
        handler = self.signal_handlers.get(number)
        if handler is not None:
            self.loop.call_soon(handler, number, None, context=self.main.context.copy())

    async def await_executor(self) -> None:
        """Wait for the threads that were lent to `asyncio.to_thread`, as `asyncio.run` does at its end."""
        while any(thread.is_alive() for thread in self.executing):
            await asyncio.sleep(EXECUTOR_POLL_S)


def here() -> Place:
    """The place that runs now."""
    return PLACE.get()


class VirtualLoop(asyncio.BaseEventLoop):
    """An event loop in which time passes only when nothing is left to do.

    Args:
        chance: draws the order in which places take turns.
    """

    def __init__(self, chance: random.Random) -> None:
        super().__init__()
        self._now = START_S
        self._chance = chance
        self._busy: list[Place] = []
        self._asleep: list[tuple[float, int, Place]] = []
        self._count = itertools.count()
        self.root = Process(self, "outside")
        self.turns = 0
        self.hub = greenlet.getcurrent()
        self.threads: list[Thread] = []

    def time(self) -> float:
        return self._now

    def run_until_complete(self, future: Any) -> Any:
        self.hub = greenlet.getcurrent()
        return super().run_until_complete(future)

    # --- what asyncio's base class leaves open

    def _process_events(self, event_list: list[Any]) -> None: ...

    def _write_to_self(self) -> None: ...

    def _timer_handle_cancelled(self, handle: asyncio.TimerHandle) -> None: ...

    def call_soon_threadsafe(self, callback: Any, *args: Any, context: Context | None = None) -> asyncio.Handle:
        if context is None:
            context = copy_context()
            context.run(PLACE.set, context.get(PLACE, self.root.main).process.main)
        return self.call_soon(callback, *args, context=context)

    def run_in_executor(self, executor: Any, func: Callable[..., Any], *args: Any) -> asyncio.Future[Any]:
        """Run `func` on a simulated thread of the calling process."""
        future: Future[Any] = Future()
        future.set_running_or_notify_cancel()  # whoever gives up waiting does not take the call back

        def work() -> None:
            try:
                result = func(*args)
            except BaseException as error:
                future.set_exception(error)
            else:
                future.set_result(result)

        executing = here().process.executing
        executing[:] = [one for one in executing if one.is_alive()]
        executing.append(thread := Thread(target=work, name="executor"))
        thread.start()
        return asyncio.wrap_future(future, loop=self)

    async def shutdown_default_executor(self, timeout: float | None = None) -> None: ...

    def add_signal_handler(self, sig: int, callback: Callable[..., object], *args: Any) -> None:
        here().process.signal_handlers[int(sig)] = lambda *_: callback(*args)

    def remove_signal_handler(self, sig: int) -> bool:
        return here().process.signal_handlers.pop(int(sig), None) is not None

    def forget(self) -> None:
        """Drop what was to be called, and close."""
        self._scheduled.clear()
        self._busy.clear()
        self._asleep.clear()
        self.close()

    # --- turns

    def _call_soon(self, callback: Any, args: Any, context: Context | None) -> asyncio.Handle:
        handle = asyncio.Handle(callback, args, self, context)
        self._enqueue(handle)
        return handle

    def _enqueue(self, handle: asyncio.Handle) -> None:
        place = handle._context.get(PLACE) or self.root.main
        if not place.process.alive:
            return
        if not place.ready:
            self._busy.append(place)
        place.ready.append(handle)

    def _run_once(self) -> None:
        scheduled, now = self._scheduled, self._now
        while scheduled and scheduled[0]._when <= now:
            timer = heapq.heappop(scheduled)
            timer._scheduled = False
            if not timer._cancelled:
                self._enqueue(timer)
        asleep = self._asleep
        while asleep and asleep[0][0] <= now:
            self._busy.append(heapq.heappop(asleep)[2])
        if not self._busy:
            self._pass_time()
            return
        index = int(self._chance.random() * len(self._busy)) if len(self._busy) > 1 else 0
        place = self._busy[index]
        if not place.process.alive:
            place.ready.clear()
            del self._busy[index]
            return
        if (awake_at := place.awake_at()) > now:
            del self._busy[index]
            heapq.heappush(asleep, (awake_at, next(self._count), place))
            return
        handle = place.ready.popleft()
        if not place.ready:
            del self._busy[index]
        self.turns += 1
        if not handle._cancelled:
            handle._run()

    def _pass_time(self) -> None:
        scheduled = self._scheduled
        while scheduled and scheduled[0]._cancelled:
            heapq.heappop(scheduled)._scheduled = False
        next_s = min(
            scheduled[0]._when if scheduled else float("inf"), self._asleep[0][0] if self._asleep else float("inf")
        )
        if next_s == float("inf"):
            raise DeadlockError
        self._now = max(self._now, next_s)


class Thread:
    """Stands in for `threading.Thread`: runs as a greenlet on the virtual clock, at a place of its own."""

    def __init__(
        self,
        group: None = None,
        target: Callable[..., Any] | None = None,
        name: str | None = None,
        args: tuple[Any, ...] = (),
        kwargs: dict[str, Any] | None = None,
        *,
        daemon: bool | None = None,
    ) -> None:
        self.daemon = daemon
        self.name = name or "thread"
        self._call = (target, args, kwargs or {})
        self._loop: VirtualLoop
        self._ended = False
        self._pauses = 0
        self._joining: list[Callable[[], None]] = []

    def start(self) -> None:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        self._loop = loop
        self.place = Place(here().process, self.name)
        self._greenlet = greenlet.greenlet(self._run, parent=loop.hub)
        self._greenlet.gr_context = self.place.context.copy()
        loop.threads.append(self)
        self.wake(self.prepare())

    def is_alive(self) -> bool:
        return not self._ended

    def join(self, timeout: float | None = None) -> None:
        wait_for(self._joining, lambda: self._ended, timeout)

    def prepare(self) -> int:
        """Announce the next pause; return its number, which a wake must name."""
        self._pauses += 1
        return self._pauses

    def wake(self, pause: int, delay_s: float = 0.0) -> asyncio.Handle:
        """End a pause after a delay; do nothing if it is over by then."""
        context = self.place.context.copy()
        if delay_s <= 0.0:
            return self._loop.call_soon(self._go_on, pause, context=context)
        return self._loop.call_later(delay_s, self._go_on, pause, context=context)

    def pause(self) -> None:
        """Wait for the wake that names this pause."""
        self._loop.hub.switch()

    def end(self) -> None:
        """Unwind it, in whatever it waits for."""
        if not self._ended and self._greenlet:
            self._greenlet.throw(greenlet.GreenletExit)

    def _go_on(self, pause: int) -> None:
        if self._pauses == pause and not self._ended:
            self._greenlet.switch()

    def _run(self) -> None:
        target, args, kwargs = self._call
        try:
            if target is not None:
                target(*args, **kwargs)
        except (SystemExit, greenlet.GreenletExit):
            pass
        finally:
            self._ended = True
            if self in self._loop.threads:
                self._loop.threads.remove(self)
            for wake in self._joining:
                wake()


def current_thread() -> Thread | None:
    """The simulated thread that runs now; None on an event loop."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    running = greenlet.getcurrent()
    return next((thread for thread in reversed(loop.threads) if thread._greenlet is running), None)


def sleep(seconds: float) -> None:
    """Stands in for `time.sleep` on a simulated thread. On an event loop it blocks that loop."""
    thread = current_thread()
    if thread is None:
        here().process.block(seconds)
        return
    thread.wake(thread.prepare(), max(seconds, 1e-9))
    thread.pause()


def wait_for(waiting: list[Callable[[], None]], condition: Callable[[], bool], timeout: float | None) -> bool:
    """Hold the calling thread until the condition holds or time is up. What makes it true calls all of `waiting`."""
    thread = current_thread()
    if thread is None or condition():
        return condition()  # a loop that waits for a thread is not simulated: it finds out at once
    deadline = None if timeout is None else thread._loop.time() + timeout
    while not condition() and (deadline is None or thread._loop.time() < deadline):
        pause = thread.prepare()
        over = None if deadline is None else thread.wake(pause, deadline - thread._loop.time())

        def wake(pause: int = pause) -> None:
            thread.wake(pause)

        waiting.append(wake)
        thread.pause()
        waiting.remove(wake)
        if over is not None:
            over.cancel()
    return condition()
