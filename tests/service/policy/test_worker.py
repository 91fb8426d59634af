"""The process of a policy, seen from its socket."""

import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from service.policy import worker
from service.policy.contract import PolicyContract
from service.policy.model import Policy
from service.policy.worker import Kind, decode, encode

SHIPPED = Path(__file__).parents[3] / "models" / "vftm-dsl.onnx"
PATIENCE_S = 20.0


class Asking:
    """A worker on a thread, and the inputs of every inference that it made."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.made: list[tuple[bytes, bytes]] = []
        act = Policy.act

        def noted(policy: Policy, observation: np.ndarray, hidden: np.ndarray | None = None) -> object:
            self.made.append((observation.tobytes(), b"" if hidden is None else hidden.tobytes()))
            return act(policy, observation, hidden)

        self.policy = Policy.load(SHIPPED)
        monkeypatch.setattr(Policy, "act", noted)
        self.socket, self._theirs = socket.socketpair()
        self.socket.settimeout(PATIENCE_S)
        self._thread = threading.Thread(
            target=worker.serve, args=(self._theirs, SHIPPED, None), kwargs={"realtime": False}
        )
        self._thread.start()
        assert self.receive()[0] is Kind.LOADED
        self.made.clear()

    def receive(self) -> tuple[Kind, bytes]:
        received = b""
        while (frame := decode(received)) is None:
            received += self.socket.recv(worker.PAYLOAD_LIMIT_BYTES)
        return frame

    def ask(self, kind: Kind, observation: np.ndarray) -> bytes:
        self.socket.sendall(encode(kind, observation.tobytes()))
        answered, payload = self.receive()
        assert answered is Kind.ACTION
        return payload

    def until_made(self, inference: tuple[bytes, bytes], times: int) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while self.made.count(inference) < times:
            assert time.monotonic() < deadline
            time.sleep(1e-3)

    def close(self) -> None:
        self.socket.close()
        self._thread.join(PATIENCE_S)
        self._theirs.close()


@pytest.fixture
def asking(monkeypatch: pytest.MonkeyPatch) -> Iterator[Asking]:
    asking = Asking(monkeypatch)
    yield asking
    asking.close()


def test_before_the_next_observation_is_due_the_last_inference_is_repeated_and_changes_nothing(
    asking: Asking,
) -> None:
    observations = np.random.default_rng(0).normal(size=(4, asking.policy.contract.observation_size))
    hidden = asking.policy.initial_hidden()
    asked = set[tuple[bytes, bytes]]()
    for step, observation in enumerate(observations.astype(np.float32)):
        assert hidden is not None
        this = observation.tobytes(), hidden.tobytes()
        asked.add(this)
        answer = asking.ask(Kind.NEXT if step else Kind.FIRST, observation)
        asking.until_made(this, 3)
        action, hidden = asking.policy.act(observation, hidden)
        assert answer == action.tobytes()
    assert set(asking.made) == asked
    time.sleep(2 * asking.policy.contract.period_s)
    made = len(asking.made)
    time.sleep(2 * asking.policy.contract.period_s)
    assert len(asking.made) == made, "a policy that nobody asks any more rests"


def test_an_observation_that_comes_early_waits_for_no_repetition(
    asking: Asking, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(PolicyContract, "period_s", 10 * PATIENCE_S)
    observation = np.zeros(asking.policy.contract.observation_size, np.float32)
    asking.ask(Kind.FIRST, observation)
    asking.ask(Kind.NEXT, observation)
    assert len(asking.made) == 2


def test_an_inference_that_takes_long_is_not_repeated_so_the_next_observation_does_not_wait_for_it(
    asking: Asking, monkeypatch: pytest.MonkeyPatch
) -> None:
    act = Policy.act

    def slow(policy: Policy, observation: np.ndarray, hidden: np.ndarray | None = None) -> object:
        until_s = time.process_time() + 2 * worker.WARM_UP_SHARE * policy.contract.period_s
        while time.process_time() < until_s:
            pass
        return act(policy, observation, hidden)

    monkeypatch.setattr(Policy, "act", slow)
    asking.ask(Kind.FIRST, np.zeros(asking.policy.contract.observation_size, np.float32))
    time.sleep(2 * asking.policy.contract.period_s)
    assert len(asking.made) == 1


def test_an_observation_that_came_with_another_waits_for_no_repetition(
    asking: Asking, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(PolicyContract, "period_s", 10 * PATIENCE_S)
    observation = np.zeros(asking.policy.contract.observation_size, np.float32).tobytes()
    asking.socket.sendall(encode(Kind.FIRST, observation) + encode(Kind.NEXT, observation))
    answer = encode(Kind.ACTION, bytes(4 * len(asking.policy.contract.action)))
    received = b""
    while len(received) < 2 * len(answer):
        received += asking.socket.recv(worker.PAYLOAD_LIMIT_BYTES)
