"""A policy's process on the virtual clock: the real model, loaded once for all universes, and slow or hanging."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from service.cell.policy_process import LOAD_S
from service.policy.contract import PolicyContract
from service.policy.model import Policy, PolicyError, PolicyFault
from tests.simulation import clock
from wire.arrays import Float32Array

if TYPE_CHECKING:
    from tests.simulation.substitutes import Host

RELOAD_S = 0.3
"""Time in which a process takes the place of one that was killed, s."""


class Inference:
    """An `InferenceKind` on the virtual clock: the real policy, answered after a while.

    Attributes:
        owed: number of the question that is not answered yet; 0 where none is.
    """

    def __init__(
        self,
        held: "Held",
        policy: Policy,
        on_action: Callable[[Float32Array], None],
        on_failure: Callable[[Exception], None],
    ) -> None:
        self._held, self._policy, self._on_action, self._on_failure = held, policy, on_action, on_failure
        self._hidden = policy.initial_hidden()
        self._closed = False
        self._asked = self.owed = 0

    def ask(self, observation: Float32Array) -> None:
        host = self._held.host
        self._asked = self.owed = self._asked + 1
        latency_s = max(host.between(host.inference_latency_s), host.inference_hangs_until - host.loop.time())
        host.loop.call_later(latency_s, self._answer, observation)

    def close(self) -> None:
        self._closed = True
        self._held.ended |= bool(self.owed)  # a process that owes an answer is killed

    def _answer(self, observation: Float32Array) -> None:
        if self._closed:
            return
        self.owed = 0
        try:
            action, self._hidden = self._policy.act(observation, self._hidden)
        except PolicyError as error:
            self._on_failure(error)
        else:
            self._on_action(action)


_LOADED: dict[Path, Policy | PolicyError] = {}


class Held:
    """A `HeldPolicy` on the virtual clock.

    Args:
        host: of all processes.
        path: ONNX file.
        expected_sha256: given where it takes the place of one that was killed; that takes `RELOAD_S`.

    Attributes:
        ended: its process was killed.
    """

    def __init__(self, host: "Host", path: Path, expected_sha256: str | None) -> None:
        self.host = host
        self.ended = False
        if path not in _LOADED:
            try:
                _LOADED[path] = Policy.load(path, expected_sha256=expected_sha256)
            except PolicyError as error:
                _LOADED[path] = error
        self._policy = _LOADED[path]
        now = host.loop.time()
        self._given_up_s = now + LOAD_S
        self._loads_until = max(now + (RELOAD_S if expected_sha256 else 0.0), host.loading_until)
        self._closed = False
        self._waiting: list[Callable[[], None]] = []

    @property
    def settled(self) -> bool:
        return self._closed or self.host.loop.time() >= min(self._loads_until, self._given_up_s)

    def loaded(self) -> tuple[str, PolicyContract]:
        clock.sleep(self.host.between(self.host.admission_latency_s))
        left_s = min(self._loads_until, self._given_up_s) - self.host.loop.time()
        if left_s > 0.0:
            clock.wait_for(self._waiting, lambda: self._closed, left_s)
        if self._closed:
            raise PolicyError(PolicyFault.ENDED, "the policy's process was killed")
        if self._loads_until > self._given_up_s:
            raise PolicyError(PolicyFault.TOO_SLOW, "the policy was not loaded in time")
        if isinstance(self._policy, PolicyError):
            raise self._policy
        return self._policy.sha256, self._policy.contract

    def infer(self, on_action: Callable[[Float32Array], None], on_failure: Callable[[Exception], None]) -> Inference:
        assert isinstance(self._policy, Policy)
        return Inference(self, self._policy, on_action, on_failure)

    def close(self) -> None:
        self._closed = True
        for wake in list(self._waiting):
            wake()
