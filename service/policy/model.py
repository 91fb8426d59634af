"""Loads a policy from its ONNX file and runs it."""

import hashlib
from enum import StrEnum
from pathlib import Path
from typing import Any, Self

import numpy as np
import onnxruntime

from service.policy import onnx_file
from service.policy.contract import METADATA_KEY, ContractError, PolicyContract
from wire.arrays import Float32Array

SIZE_LIMIT_BYTES = 16 * 2**20
OPSETS = range(11, 24)
"""Versions of the standard operator set that are admitted."""
RANDOM = frozenset(
    {"RandomNormal", "RandomNormalLike", "RandomUniform", "RandomUniformLike", "Multinomial", "Bernoulli"}
)
"""Standard operators that draw random numbers."""
DROPOUT_TRAINING_INPUTS = 3
"""Inputs of a `Dropout` that may be told to train, that is to draw random numbers."""


class PolicyFault(StrEnum):
    """Reason for which a policy file or an inference is refused."""

    UNREADABLE = "UNREADABLE"
    TOO_LARGE = "TOO_LARGE"
    HASH = "HASH"
    CORRUPT = "CORRUPT"
    EXTERNAL_DATA = "EXTERNAL_DATA"
    OPSET = "OPSET"
    RANDOM = "RANDOM"
    CONTRACT_MISSING = "CONTRACT_MISSING"
    CONTRACT_INVALID = "CONTRACT_INVALID"
    SIGNATURE = "SIGNATURE"
    FAILED = "FAILED"
    INVALID_OBSERVATION = "INVALID_OBSERVATION"
    INVALID_OUTPUT = "INVALID_OUTPUT"
    TOO_SLOW = "TOO_SLOW"
    ENDED = "ENDED"


class PolicyError(Exception):
    """A policy cannot be used. `reason` is a stable code; the text says what is wrong and where."""

    def __init__(self, reason: PolicyFault, text: str) -> None:
        super().__init__(f"{reason}: {text}")
        self.reason = reason
        self.text = text


class Policy:
    """A loaded policy. The bytes that run are the bytes that were hashed, whatever happens to the file."""

    def __init__(self, data: bytes, *, source: str = "<bytes>", expected_sha256: str | None = None) -> None:
        """Load from bytes.

        Args:
            data: the whole ONNX file.
            source: origin of the bytes, for messages.
            expected_sha256: hex digest that the bytes must have; None: any.

        Raises:
            PolicyError: the policy cannot be used; the text names the first problem found.
        """
        self.source = source
        if len(data) > SIZE_LIMIT_BYTES:
            raise PolicyError(PolicyFault.TOO_LARGE, f"{source} is larger than {SIZE_LIMIT_BYTES} bytes")
        self.sha256 = hashlib.sha256(data).hexdigest()
        if expected_sha256 is not None and expected_sha256 != self.sha256:
            raise PolicyError(
                PolicyFault.HASH,
                f"{source} has SHA-256 {self.sha256}, only {expected_sha256} is admitted: restore the file or admit it",
            )
        self.contract = _read_contract(data, source)
        self._recurrent = self.contract.hidden_size > 0
        # Within one graph an input and an output cannot share a name
        self._inputs = {"observation": self.contract.observation_size}
        self._outputs = {"action": len(self.contract.action)}
        if self._recurrent:
            self._inputs["hidden"] = self._outputs["next_hidden"] = self.contract.hidden_size
        try:
            self._session = onnxruntime.InferenceSession(
                data,
                session_options(),
                providers=["CPUExecutionProvider"],
                enable_fallback=0,  # it prints to the console and tries the same provider again
            )
            inputs, outputs = (
                [(node.name, node.type, list(node.shape)) for node in nodes]
                for nodes in (self._session.get_inputs(), self._session.get_outputs())
            )
        except Exception as error:  # ONNX Runtime's errors share no public base class
            raise PolicyError(PolicyFault.CORRUPT, f"ONNX Runtime refuses {source}: {error}") from error
        self._check_signature("inputs", inputs, self._inputs)
        self._check_signature("outputs", outputs, self._outputs)
        self._probe()

    @classmethod
    def load(cls, path: Path, *, expected_sha256: str | None = None) -> Self:
        """Load from a file, reading it once.

        Raises:
            PolicyError: the policy cannot be used; the text names the first problem found.
        """
        try:
            with path.open("rb") as file:
                data = file.read(SIZE_LIMIT_BYTES + 1)
        except OSError as error:
            raise PolicyError(PolicyFault.UNREADABLE, f"cannot read {path}: {error.strerror}") from error
        return cls(data, source=str(path), expected_sha256=expected_sha256)

    def initial_hidden(self, shape: tuple[int, ...] = ()) -> Float32Array | None:
        """Return the recurrent state before the first step: (*shape, hidden_size) zeros; None for a policy without."""
        return np.zeros((*shape, self.contract.hidden_size), np.float32) if self._recurrent else None

    def act(
        self, observation: Float32Array, hidden: Float32Array | None = None
    ) -> tuple[Float32Array, Float32Array | None]:
        """Run one inference.

        Args:
            observation: (..., n) raw physical units, as the contract's builder makes it.
            hidden: (..., hidden_size) from `initial_hidden` or the last call; None for a policy without one.

        Returns:
            (..., a) action, within -1 … 1 if the graph limits it, and the next recurrent state.

        Raises:
            PolicyError: INVALID_OBSERVATION: an input is not finite or has another shape. INVALID_OUTPUT: a result is
                not finite or has another shape (ONNX Runtime passes NaN through silently). FAILED: ONNX Runtime raised
                an error.
        """
        size = self._inputs["observation"]
        if observation.shape[-1:] != (size,) or not np.isfinite(observation).all():
            raise PolicyError(
                PolicyFault.INVALID_OBSERVATION,
                f"want (..., {size}) finite numbers, got shape {observation.shape}: {self._name_bad(observation)}",
            )
        batch = observation.shape[:-1]
        feed = {"observation": np.ascontiguousarray(observation, np.float32).reshape(-1, size)}
        if self._recurrent:
            if hidden is None or hidden.shape != (*batch, self.contract.hidden_size) or not np.isfinite(hidden).all():
                raise PolicyError(
                    PolicyFault.INVALID_OBSERVATION, f"want a finite hidden state {(*batch, self.contract.hidden_size)}"
                )
            feed["hidden"] = np.ascontiguousarray(hidden, np.float32).reshape(-1, self.contract.hidden_size)
        try:
            results: list[Float32Array] = self._session.run(list(self._outputs), feed)
        except Exception as error:  # ONNX Runtime's errors share no public base class
            raise PolicyError(PolicyFault.FAILED, f"{self.source} does not run: {error}") from error
        rows = len(feed["observation"])
        for (name, width), result in zip(self._outputs.items(), results, strict=True):
            if result.shape != (rows, width):
                raise PolicyError(
                    PolicyFault.INVALID_OUTPUT, f"{self.source}: {name} has shape {result.shape}, want {(rows, width)}"
                )
            if not np.isfinite(result).all():
                raise PolicyError(PolicyFault.INVALID_OUTPUT, f"{self.source}: {name} is not finite")
        action, *rest = (result.reshape(*batch, result.shape[-1]) for result in results)
        return action, rest[0] if rest else None

    def _name_bad(self, observation: Float32Array) -> str:
        """Name the entries that hold a number that is not finite."""
        names = [entry.name for entry in self.contract.observation for _ in range(entry.size * entry.history)]
        if observation.shape[-1:] != (len(names),):
            return "wrong length"
        bad = np.flatnonzero(~np.isfinite(observation.reshape(-1, len(names))).all(0))
        return "not finite in " + ", ".join(dict.fromkeys(names[index] for index in bad.tolist()))

    def _check_signature(self, what: str, nodes: list[tuple[str, str, list[Any]]], want: dict[str, int]) -> None:
        """Compare the graph's inputs or outputs (name, type, shape) with the widths that the contract implies."""
        names = sorted(name for name, _, _ in nodes)
        if names != sorted(want):
            raise PolicyError(PolicyFault.SIGNATURE, f"{self.source}: {what} are {names}, want {sorted(want)}")
        for name, kind, shape in nodes:
            # A fixed dimension is a number; an open one is a name or None
            open_batch = len(shape) == 2 and (shape[0] == 1 or not isinstance(shape[0], int))
            if kind != "tensor(float)" or not open_batch or shape[1] != want[name]:
                raise PolicyError(
                    PolicyFault.SIGNATURE,
                    f"{self.source}: {name} is {kind} {shape}, want tensor(float) [batch, {want[name]}]",
                )

    def _probe(self) -> None:
        """Run the graph twice at zero and at plus and minus each entry's scale, to find a failure before any motion."""
        scales = [
            np.broadcast_to(np.asarray(entry.scale, np.float32), (entry.history, entry.size)).ravel()
            for entry in self.contract.observation
        ]
        for factor in (0.0, 1.0, -1.0):
            observation = (factor * np.concatenate(scales)).astype(np.float32)
            once, again = (self.act(observation, self.initial_hidden()) for _ in range(2))
            if any((a != b).any() for a, b in zip(once, again, strict=True) if a is not None and b is not None):
                text = f"{self.source} answers one observation in two ways: one file must give one action"
                raise PolicyError(PolicyFault.RANDOM, text)


def _read_contract(data: bytes, source: str) -> PolicyContract:
    try:
        head = onnx_file.inspect(data)
    except onnx_file.MalformedError as error:
        raise PolicyError(PolicyFault.CORRUPT, f"{source} is not an ONNX model: {error}") from error
    if head.external_data:
        raise PolicyError(PolicyFault.EXTERNAL_DATA, f"{source} keeps weights in another file: export it as one file")
    if head.opsets.get("") not in OPSETS:
        raise PolicyError(
            PolicyFault.OPSET,
            f"{source} imports operator sets {head.opsets}, admitted is the standard one in versions {OPSETS[0]} to "
            f"{OPSETS[-1]}",
        )
    _check_operators(head, source)
    text = head.metadata.get(METADATA_KEY)
    if text is None:
        raise PolicyError(PolicyFault.CONTRACT_MISSING, f"{source} has no metadata {METADATA_KEY!r}")
    try:
        return PolicyContract.from_json(text)
    except ContractError as error:
        raise PolicyError(PolicyFault.CONTRACT_INVALID, f"{source}: {error}") from error


def _check_operators(head: onnx_file.OnnxFile, source: str) -> None:
    """Judge the nodes of every graph, subgraph and function; an import that no node uses is no reason to refuse."""
    foreign = [one for one in head.operators if one.domain and (one.domain, one.name) not in head.functions]
    if foreign:
        names = ", ".join(sorted(f"{one.domain}.{one.name}" for one in foreign))
        raise PolicyError(PolicyFault.OPSET, f"{source} uses {names}; only operators of the standard set are admitted")
    sampling = sorted(
        {one.name for one in head.operators if one.name in RANDOM}
        | {one.name for one in head.operators if one.name == "Dropout" and one.inputs >= DROPOUT_TRAINING_INPUTS}
    )
    if sampling:
        raise PolicyError(
            PolicyFault.RANDOM,
            f"{source} draws random numbers ({', '.join(sampling)}): one file must give one action; export its mean",
        )


def session_options() -> Any:
    """Return the options under which ONNX Runtime loads a policy."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 4
    # A spinning thread would take a core from the 500 Hz loop
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.add_session_config_entry("session.inter_op.allow_spinning", "0")
    # Weights stored as small integers are unpacked once, not at every step. Packed for the processor they would give
    # other last bits.
    options.add_session_config_entry("session.disable_quant_qdq", "1")
    options.add_session_config_entry("session.disable_prepacking", "1")
    return options
