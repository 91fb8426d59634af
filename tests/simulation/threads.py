"""Stand-ins for `queue` and `threading`, for code that starts threads of its own."""

from collections import deque
from collections.abc import Callable
from queue import Empty
from types import SimpleNamespace
from typing import Any

from tests.simulation import clock


class SimpleQueue:
    """Stands in for `queue.SimpleQueue` among simulated threads."""

    def __init__(self) -> None:
        self._items: deque[Any] = deque()
        self._waiting: list[Callable[[], None]] = []

    def put(self, item: Any) -> None:
        self._items.append(item)
        for wake in self._waiting[:1]:
            wake()

    put_nowait = put

    def get(self, block: bool = True, timeout: float | None = None) -> Any:
        if block and not self._items:
            clock.wait_for(self._waiting, lambda: bool(self._items), timeout)
        if not self._items:
            raise Empty
        return self._items.popleft()

    def get_nowait(self) -> Any:
        return self.get(block=False)

    def qsize(self) -> int:
        return len(self._items)

    def empty(self) -> bool:
        return not self._items


class Lock:
    """Stands in for `threading.Lock`: simulated threads never switch within a locked section that does not wait."""

    def __enter__(self) -> bool:
        return True

    def __exit__(self, *_: object) -> None: ...

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        return True

    def release(self) -> None: ...


THREADING = SimpleNamespace(Thread=clock.Thread, Lock=Lock, RLock=Lock)
QUEUE = SimpleNamespace(SimpleQueue=SimpleQueue, Queue=SimpleQueue, Empty=Empty)
