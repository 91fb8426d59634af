"""Time spent inside one method of a class, or one function of a module, while other code calls it."""

import time
from collections.abc import Generator
from contextlib import contextmanager
from functools import wraps
from types import ModuleType
from typing import Any


class Stopwatch:
    """Begin and end of every call, in seconds of `perf_counter`."""

    def __init__(self) -> None:
        self.calls: list[tuple[float, float]] = []

    @property
    def spans_s(self) -> list[float]:
        return [end - begin for begin, end in self.calls]

    @property
    def spent_s(self) -> float:
        return sum(self.spans_s)

    def split(self, inner: "Stopwatch") -> tuple[list[float], list[float]]:
        """Return the spans of calls in which `inner` was called, and those of the others."""
        begins = [begin for begin, _ in inner.calls]
        within: list[float] = []
        without: list[float] = []
        index = 0
        for begin, end in self.calls:
            while index < len(begins) and begins[index] < begin:
                index += 1
            hit = index < len(begins) and begins[index] < end
            (within if hit else without).append(end - begin)
        return within, without


@contextmanager
def timed(owner: type[Any] | ModuleType, method: str) -> Generator[Stopwatch]:
    """Measure every call of `owner.method` until the block ends; this costs about a microsecond per call."""
    watch = Stopwatch()
    original = owner.__dict__[method]

    @wraps(original)
    def measured(*args: Any, **kwargs: Any) -> Any:
        begin = time.perf_counter()
        try:
            return original(*args, **kwargs)
        finally:
            watch.calls.append((begin, time.perf_counter()))

    setattr(owner, method, measured)
    try:
        yield watch
    finally:
        setattr(owner, method, original)
