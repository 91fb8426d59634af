"""The process in which a policy of a cell is loaded and run: `python -m service.policy.worker`.

It serves one model to one parent over a socket. It answers each observation with one action, in the order asked, and
keeps the recurrent state between the steps of a run. The parent kills it when it gives no answer in time, so it holds
nothing that must be released.
"""

import contextlib
import json
import os
import resource
import select
import signal
import socket
import statistics
import struct
import sys
import time
from enum import IntEnum
from pathlib import Path

import numpy as np

from service.policy.model import Policy, PolicyError, PolicyFault
from service.program import bound_to
from wire.arrays import Float32Array
from wire.realtime import request_prompt_answers

HEAD = struct.Struct("<BI")
"""Head of a frame: its kind, and the length of its payload in bytes."""
PAYLOAD_LIMIT_BYTES = 2**20
RECEIVED_AT_ONCE_BYTES = 2**14
"""Most bytes that one read of the socket asks for. The system's memory for a read of a whole payload costs 20 µs."""
NICENESS = 1
"""Distance from an ordinary process's priority while it loads, and without real-time scheduling."""
MEMORY_LIMIT_BYTES = 2**30
"""Address space of a worker. Python, numpy and ONNX Runtime take about a quarter of it, a model's file 16 MiB."""
LONGEST_INFERENCE_S = 2.0
"""Processor time of one inference after which the kernel kills the process; no deadline of a cell is as long, s."""
WARM_UP_SHARE = 0.03
"""Share of the period in front of the next observation in which the last inference is repeated, so that caches are warm
for it: after 100 ms of rest a first inference takes six times as long as a third."""
REHEARSALS = 9
"""Inferences at zero that are timed after loading; the median is reported."""


class Kind(IntEnum):
    """Kind of a frame."""

    LOADED = 1
    """To the parent: JSON with `sha256`, `contract` and `step_s`."""
    REFUSED = 2
    """To the parent: JSON with `reason` and `text`; the policy cannot be used."""
    FIRST = 3
    """To the worker: the first observation of a run, float32."""
    NEXT = 4
    """To the worker: a later observation, float32."""
    ACTION = 5
    """To the parent: the action, float32."""


class BrokenFrameError(Exception):
    """The bytes received are no frame."""


def encode(kind: Kind, payload: bytes) -> bytes:
    """Return a frame."""
    return HEAD.pack(kind, len(payload)) + payload


def decode(received: bytes | bytearray) -> tuple[Kind, bytes] | None:
    """Return the frame at the beginning of what was received; None while it is not whole.

    Raises:
        BrokenFrameError: the bytes are no frame.
    """
    if len(received) < HEAD.size:
        return None
    number, length = HEAD.unpack_from(received)
    try:
        kind = Kind(number)
    except ValueError as error:
        raise BrokenFrameError(str(error)) from None
    if length > PAYLOAD_LIMIT_BYTES:
        raise BrokenFrameError(f"a payload of {length} bytes")
    if len(received) < HEAD.size + length:
        return None
    return kind, bytes(received[HEAD.size : HEAD.size + length])


def serve(connection: socket.socket, path: Path, sha256: str | None, *, realtime: bool) -> None:
    """Load a policy, say so, and answer until the parent closes the connection.

    Args:
        connection: to the parent.
        path: ONNX file.
        sha256: hex digest that the file must have; None: any.
        realtime: ask for real-time scheduling.
    """
    try:
        policy = Policy.load(path, expected_sha256=sha256)
        loaded = {"sha256": policy.sha256, "contract": policy.contract.to_json(), "step_s": _rehearse(policy)}
    except PolicyError as error:
        connection.sendall(_refusal(error))
        return
    except MemoryError:
        text = f"{path} needs more than {MEMORY_LIMIT_BYTES >> 20} MiB"
        connection.sendall(_refusal(PolicyError(PolicyFault.TOO_LARGE, text)))
        return
    if realtime:
        request_prompt_answers(LONGEST_INFERENCE_S)
    connection.sendall(encode(Kind.LOADED, json.dumps(loaded).encode()))
    hidden = policy.initial_hidden()
    received = bytearray()
    while data := connection.recv(RECEIVED_AT_ONCE_BYTES):
        arrived_s = time.monotonic()
        received += data
        while (frame := decode(received)) is not None:
            kind, payload = frame
            del received[: HEAD.size + len(payload)]
            if kind is Kind.FIRST:
                hidden = policy.initial_hidden()
            asked = np.frombuffer(payload, np.float32), hidden
            begun_s = time.monotonic()
            answer, hidden = _answer(policy, *asked)
            spent_s = time.monotonic() - begun_s
            connection.sendall(answer)
            if not received:
                _warm_up(connection, policy, asked, spent_s, arrived_s + policy.contract.period_s)


def _warm_up(
    connection: socket.socket,
    policy: Policy,
    asked: tuple[Float32Array, Float32Array | None],
    spent_s: float,
    due_s: float,
) -> None:
    """Return when the next observation is there, or late; rest first, then repeat an inference, then stay awake.

    An inference is repeated only if it would end before the observation is due, which must not wait for it.

    Args:
        connection: to the parent.
        policy: its answers are discarded.
        asked: what it was asked last.
        spent_s: duration of that inference, s.
        due_s: monotonic time at which the next observation is due.
    """
    share_s = WARM_UP_SHARE * policy.contract.period_s

    def comes(within_s: float) -> bool:
        return bool(select.select([connection], [], [], max(0.0, within_s))[0])

    if comes(due_s - share_s - time.monotonic()):
        return
    while (begun_s := time.monotonic()) + spent_s < due_s and not comes(0.0):
        _answer(policy, *asked)
        spent_s = time.monotonic() - begun_s
    while time.monotonic() < due_s + share_s and not comes(0.0):
        pass


def _answer(
    policy: Policy, observation: Float32Array, hidden: Float32Array | None
) -> tuple[bytes, Float32Array | None]:
    try:
        action, hidden = policy.act(observation, hidden)
    except PolicyError as error:
        return _refusal(error), hidden
    return encode(Kind.ACTION, action.astype(np.float32).tobytes()), hidden


def _refusal(error: PolicyError) -> bytes:
    return encode(Kind.REFUSED, json.dumps({"reason": error.reason, "text": error.text[:2000]}).encode())


def _rehearse(policy: Policy) -> float:
    """Return the median time of an inference, s. Loading has run the graph, so nothing is slow for being new."""
    observation = np.zeros(policy.contract.observation_size, np.float32)
    spans: list[float] = []
    for _ in range(REHEARSALS):
        begun = time.perf_counter()
        policy.act(observation, policy.initial_hidden())
        spans.append(time.perf_counter() - begun)
    return statistics.median(spans)


def _confine(parent: int) -> None:
    """Give up real-time priority, bound the memory, and end with the parent, in whatever way that one ends."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # when a host shuts down, the parent stops the arm first
    if (bind := bound_to(parent)) is not None:
        bind()
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(NICENESS)
    for what, limit in ((resource.RLIMIT_AS, MEMORY_LIMIT_BYTES), (resource.RLIMIT_CORE, 0)):
        _, hard = resource.getrlimit(what)
        most = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(what, (most, hard))


def main(handle: str, parent: str, scheduling: str, path: str, sha256: str) -> None:
    """Serve one policy.

    Args:
        handle: number of the inherited socket.
        parent: process id of the parent.
        scheduling: `realtime` or `ordinary`.
        path: ONNX file.
        sha256: hex digest that the file must have; empty: any.
    """
    _confine(int(parent))
    with socket.socket(fileno=int(handle)) as connection, contextlib.suppress(BrokenPipeError, ConnectionResetError):
        serve(connection, Path(path), sha256 or None, realtime=scheduling == "realtime")


if __name__ == "__main__":
    main(*sys.argv[1:])
