"""A policy in a process of its own, which is killed as soon as it owes an answer for too long."""

import asyncio
import json
import os
import select
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np

from service.cell.inference import Inference, OnAction, OnFailure, PolicyOpener
from service.policy.contract import ContractError, PolicyContract
from service.policy.model import PolicyError, PolicyFault
from service.policy.worker import HEAD, RECEIVED_AT_ONCE_BYTES, BrokenFrameError, Kind, decode, encode
from wire.arrays import Float32Array

LOAD_S = 20.0
"""Time in which a worker must have started, loaded its model and run it, s."""
LOCKSTEP_S = 1.0
"""Host time for an answer where the world waits for it, s."""
JOIN_S = 1.0
"""Time in which a killed process is gone, s."""


class PolicyProcess:
    """One policy in one process. The process starts at once and loads; `loaded` waits for it.

    A process that does not load in time is killed, whether anybody waits or not.

    Args:
        path: ONNX file.
        expected_sha256: hex digest that the file must have; None: any.
        step_limit_s: longest admissible time of one inference, s.
        patience_s: host time for which `Inference.ask` waits for its answer; None: it does not wait, and the answer
            comes to the event loop.
        realtime: the process asks for real-time scheduling, below the loop's.

    Raises:
        OSError: no process can be made.
    """

    def __init__(
        self,
        path: Path,
        expected_sha256: str | None = None,
        *,
        step_limit_s: float,
        patience_s: float | None = None,
        realtime: bool = False,
    ) -> None:
        self.source = str(path)
        self.actions = 0
        self.patience_s = patience_s
        self._step_limit_s = step_limit_s
        self.socket, theirs = socket.socketpair()
        with theirs:
            scheduling = "realtime" if realtime else "ordinary"
            arguments = (str(theirs.fileno()), str(os.getpid()), scheduling, str(path), expected_sha256 or "")
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "service.policy.worker", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(),),
                start_new_session=True,
                env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            )
        self._loaded: Future[tuple[str, PolicyContract]] = Future()
        self._attendant = threading.Thread(target=self._attend, name="policy", daemon=True)
        self._attendant.start()

    @classmethod
    def opener(cls, step_limit_s: float, *, lockstep: bool, realtime: bool = False) -> PolicyOpener:
        """Return what opens the policies of a cell.

        Args:
            step_limit_s: longest admissible time of one inference, s.
            lockstep: the world waits for each answer.
            realtime: their processes ask for real-time scheduling.
        """

        def open_policy(path: Path, expected_sha256: str | None) -> PolicyProcess:
            patience_s = LOCKSTEP_S if lockstep else None
            return cls(path, expected_sha256, step_limit_s=step_limit_s, patience_s=patience_s, realtime=realtime)

        return open_policy

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def ended(self) -> bool:
        return self._loaded.done() and self._loaded.exception() is None and self._process.returncode is not None

    @property
    def settled(self) -> bool:
        return self._loaded.done()

    def loaded(self) -> tuple[str, PolicyContract]:
        return self._loaded.result()

    def infer(self, on_action: OnAction, on_failure: OnFailure) -> Inference:
        return WorkerInference(self, on_action, on_failure)

    def kill(self) -> None:
        """End the process at once, without waiting for its end."""
        self._process.kill()

    def close(self) -> None:
        self.kill()
        self._attendant.join(JOIN_S)
        self.socket.close()

    def why_ended(self) -> PolicyError:
        """Return the error of a process that has closed its side of the socket."""
        status = self._process.returncode
        how = "" if status is None else f" with status {status}"
        return PolicyError(PolicyFault.ENDED, f"the process of {self.source} has ended{how}")

    # --- on the attendant's thread

    def _attend(self) -> None:
        """Await the model, then the process's end, so that no dead process is left behind."""
        try:
            loaded = self._await_model()
        except Exception as error:
            self.kill()
            self._process.wait()
            if not isinstance(error, PolicyError):
                error = PolicyError(PolicyFault.FAILED, f"{self.source}: {type(error).__name__}: {error}")
            self._loaded.set_exception(error)
        else:
            self.socket.setblocking(False)
            self._loaded.set_result(loaded)
            self._process.wait()

    def _await_model(self) -> tuple[str, PolicyContract]:
        deadline = time.monotonic() + LOAD_S
        received = bytearray()
        while (frame := decode(received)) is None:
            self.socket.settimeout(max(1e-3, deadline - time.monotonic()))
            try:
                data = self.socket.recv(RECEIVED_AT_ONCE_BYTES)
            except TimeoutError:
                text = f"{self.source} was not loaded and tried within {LOAD_S:g} s; its process was killed"
                raise PolicyError(PolicyFault.TOO_SLOW, text) from None
            if not data:
                self._process.wait(JOIN_S)
                raise self.why_ended()
            received += data
        kind, payload = frame
        if kind is Kind.REFUSED:
            raise read_refusal(payload)
        document: dict[str, Any] = json.loads(payload)
        try:
            contract = PolicyContract.from_json(document["contract"])
        except ContractError as error:
            raise PolicyError(PolicyFault.CONTRACT_INVALID, f"{self.source}: {error}") from error
        if (step_s := float(document["step_s"])) >= self._step_limit_s:
            limit = f"limits.policy_deadline_s is {self._step_limit_s * 1e3:g} ms"
            text = f"{self.source} takes {step_s * 1e3:.3g} ms for one inference, {limit}"
            raise PolicyError(PolicyFault.TOO_SLOW, text)
        self.actions = len(contract.action)
        return str(document["sha256"]), contract


class WorkerInference:
    """Asks a worker. A worker that still owes an answer when its run ends is killed.

    Args:
        worker: loaded.
        on_action: takes each action.
        on_failure: takes the exception that comes in an action's place.
    """

    def __init__(self, worker: PolicyProcess, on_action: OnAction, on_failure: OnFailure) -> None:
        self._worker = worker
        self._on_action = on_action
        self._on_failure = on_failure
        self._kind = Kind.FIRST
        self._owed = self._closed = False
        self._received = bytearray()
        self._loop = asyncio.get_running_loop() if worker.patience_s is None else None
        if self._loop is not None:
            self._loop.add_reader(worker.socket, self._read)

    def ask(self, observation: Float32Array) -> None:
        self._owed = True
        frame = encode(self._kind, observation.astype(np.float32).tobytes())
        self._kind = Kind.NEXT
        try:
            whole = self._worker.socket.send(frame) == len(frame)
        except OSError:
            whole = False
        if not whole:
            self._fail(self._worker.why_ended())
        elif self._worker.patience_s is not None:
            self._await_answer(self._worker.patience_s)

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        if self._loop is not None:
            self._loop.remove_reader(self._worker.socket)
        if self._owed:
            self._worker.kill()

    def _await_answer(self, patience_s: float) -> None:
        poll = select.poll()
        poll.register(self._worker.socket, select.POLLIN)
        deadline = time.monotonic() + patience_s
        while self._owed and not self._closed:
            if not poll.poll(max(0.0, deadline - time.monotonic()) * 1e3):
                text = f"{self._worker.source} gave no answer within {patience_s:g} s of the host's time"
                self._fail(PolicyError(PolicyFault.TOO_SLOW, text))
                return
            self._read()

    def _read(self) -> None:
        try:
            data = self._worker.socket.recv(RECEIVED_AT_ONCE_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        self._received += data
        try:
            frame = decode(self._received)
        except BrokenFrameError as error:
            self._fail(PolicyError(PolicyFault.INVALID_OUTPUT, f"the process of {self._worker.source} sent {error}"))
            return
        if not data:
            self._fail(self._worker.why_ended())
        elif frame is not None:
            self._take(*frame)

    def _take(self, kind: Kind, payload: bytes) -> None:
        del self._received[: HEAD.size + len(payload)]
        whole = kind is Kind.ACTION and len(payload) == 4 * self._worker.actions
        if not self._owed or self._received or not (whole or kind is Kind.REFUSED):
            text = f"the process of {self._worker.source} sent what nobody asked for"
            self._fail(PolicyError(PolicyFault.INVALID_OUTPUT, text))
            return
        self._owed = False
        if whole:
            self._on_action(np.frombuffer(payload, np.float32))
        else:
            self._on_failure(read_refusal(payload))

    def _fail(self, error: PolicyError) -> None:
        """Report a failure; whatever the worker does now is of no use."""
        if self._closed:
            return
        self._owed = True
        self.close()
        self._on_failure(error)


def read_refusal(payload: bytes) -> PolicyError:
    """Return the error that a worker has sent."""
    try:
        document: dict[str, str] = json.loads(payload)
        return PolicyError(PolicyFault(document["reason"]), document["text"])
    except (ValueError, KeyError, TypeError):
        return PolicyError(PolicyFault.INVALID_OUTPUT, "the policy's process sent an error that cannot be read")
