"""Queries over Zenoh, one at a time, and their durations."""

import time
from collections.abc import Callable

import zenoh

TIMEOUT_S = 5.0


def until_answered(session: zenoh.Session, selector: str, payload: bytes | None = None) -> None:
    """Wait until the other side's queryable is known here.

    Raises:
        TimeoutError: the other side does not answer.
    """
    deadline = time.monotonic() + TIMEOUT_S
    while not any(reply.ok is not None for reply in session.get(selector, payload=payload, timeout=0.5)):
        if time.monotonic() > deadline:
            raise TimeoutError(f"no answer on {selector}")
        time.sleep(0.05)


def answer(session: zenoh.Session, selector: str, payload: bytes | None = None) -> bytes:
    """Return the first answer.

    Raises:
        TimeoutError: there is no answer.
    """
    for reply in session.get(selector, payload=payload, timeout=TIMEOUT_S):
        if reply.ok is not None:
            return reply.ok.payload.to_bytes()
    raise TimeoutError(f"no answer on {selector}")


def spans(count: int, exchange: Callable[[], object]) -> list[float]:
    """Return the duration of each of `count` exchanges, s, after a tenth as many to warm up."""
    taken: list[float] = []
    for number in range(count + count // 10):
        begin = time.perf_counter()
        exchange()
        if number >= count // 10:
            taken.append(time.perf_counter() - begin)
    return taken
