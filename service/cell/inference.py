"""The policy of one run, as the run sees it; and the policy that computes in this process, in the event loop."""

from collections.abc import Callable
from pathlib import Path
from typing import Protocol, Self

from service.policy.contract import PolicyContract
from service.policy.model import Policy, PolicyError
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
    """Constructor of an `Inference` that computes in this process."""

    def __call__(self, policy: Policy, on_action: OnAction, on_failure: OnFailure) -> Inference: ...


class HeldPolicy(Protocol):
    """A policy that a cell has opened: being loaded, ready for runs, or refused."""

    def loaded(self) -> tuple[str, PolicyContract]:
        """Wait until the policy is loaded; return its file's SHA-256 and its contract.

        Raises:
            PolicyError: it cannot be used; the text says why.
        """
        ...

    @property
    def settled(self) -> bool:
        """True once the policy is loaded or refused, so that `loaded` does not wait."""
        ...

    @property
    def ended(self) -> bool:
        """True for a policy that was loaded and has come to an end since: it must be opened anew."""
        ...

    def infer(self, on_action: OnAction, on_failure: OnFailure) -> Inference:
        """Begin a run; `loaded` has returned.

        Args:
            on_action: takes each action, (m,) float32.
            on_failure: takes the exception that comes in an action's place.
        """
        ...

    def close(self) -> None:
        """Release everything. May block for a moment."""
        ...


class PolicyOpener(Protocol):
    """Opens a policy's file: `PolicyProcess.opener`, or `InProcessPolicy` for tests."""

    def __call__(self, path: Path, expected_sha256: str | None) -> HeldPolicy: ...


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


class InProcessPolicy:
    """A policy that runs in this process, which a model that hangs takes along. For tests and measurements.

    Args:
        path: ONNX file.
        expected_sha256: hex digest that the file must have; None: any.
        kind: how runs get their inference.
    """

    settled = True
    ended = False

    def __init__(
        self, path: Path, expected_sha256: str | None = None, *, kind: InferenceKind = InlineInference
    ) -> None:
        self._kind = kind
        self._policy: Policy | PolicyError
        try:
            self._policy = Policy.load(path, expected_sha256=expected_sha256)
        except PolicyError as error:
            self._policy = error

    @classmethod
    def opener(cls, kind: InferenceKind) -> PolicyOpener:
        """Return what opens policies whose runs get this kind of inference."""

        def open_policy(path: Path, expected_sha256: str | None) -> Self:
            return cls(path, expected_sha256, kind=kind)

        return open_policy

    def loaded(self) -> tuple[str, PolicyContract]:
        policy = self._loaded()
        return policy.sha256, policy.contract

    def infer(self, on_action: OnAction, on_failure: OnFailure) -> Inference:
        return self._kind(self._loaded(), on_action, on_failure)

    def close(self) -> None:
        """Do nothing."""

    def _loaded(self) -> Policy:
        if isinstance(self._policy, PolicyError):
            raise self._policy
        return self._policy
