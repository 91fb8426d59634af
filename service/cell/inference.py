"""Computation of the policy's answer: in the event loop in lockstep, on a thread in real time."""

import asyncio
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Protocol

from service.policy.model import Policy
from wire.arrays import Float32Array

OnAction = Callable[[Float32Array], None]
OnFailure = Callable[[Exception], None]


class Inference(Protocol):
    """The policy of one run. Every `ask` is answered at most once, on the event loop's thread."""

    def ask(self, observation: Float32Array) -> None: ...

    def close(self) -> None:
        """Give no answer any more."""
        ...


class InferenceKind(Protocol):
    """Constructor of an `Inference`: one of the two classes below."""

    def __call__(self, policy: Policy, on_action: OnAction, on_failure: OnFailure) -> Inference: ...


class InlineInference:
    """Computes before `ask` returns; in lockstep no time passes meanwhile.

    Args:
        policy: loaded.
        on_action: takes the action.
        on_failure: takes the policy's exception.
    """

    def __init__(self, policy: Policy, on_action: OnAction, on_failure: OnFailure) -> None:
        self._policy = policy
        self._on_action = on_action
        self._on_failure = on_failure
        self._hidden = policy.initial_hidden()

    def ask(self, observation: Float32Array) -> None:
        try:
            action, self._hidden = self._policy.act(observation, self._hidden)
        except Exception as error:
            self._on_failure(error)
        else:
            self._on_action(action)

    def close(self) -> None:
        """Do nothing: no computation is under way between two calls."""


class ThreadInference:
    """Computes on its own thread: the monitor sees every sample meanwhile, and the run holds its last target.

    Args:
        policy: loaded.
        on_action: takes the action.
        on_failure: takes the policy's exception.
    """

    def __init__(self, policy: Policy, on_action: OnAction, on_failure: OnFailure) -> None:
        self._policy = policy
        self._on_action = on_action
        self._on_failure = on_failure
        self._hidden = policy.initial_hidden()
        self._loop = asyncio.get_running_loop()
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="policy")
        self._closed = False

    def ask(self, observation: Float32Array) -> None:
        future = self._executor.submit(self._policy.act, observation, self._hidden)
        future.add_done_callback(self._hand_back)

    def close(self) -> None:
        self._closed = True
        self._executor.shutdown(wait=False, cancel_futures=True)

    def _hand_back(self, future: Future[tuple[Float32Array, Float32Array | None]]) -> None:
        # On the policy's thread, or on the loop's when the future was cancelled before it began.
        if not self._closed and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._answer, future)

    def _answer(self, future: Future[Any]) -> None:
        if self._closed:
            return
        if (error := future.exception()) is not None:
            self._on_failure(error if isinstance(error, Exception) else RuntimeError(str(error)))
            return
        action, self._hidden = future.result()
        self._on_action(action)
