"""Small real policies: ONNX files whose answer is a linear function of a few observations."""

from pathlib import Path

import numpy as np

from service.policy.contract import ObservationEntry, PolicyContract
from tests.service.policy.model_files import contract, failing_model, greedy_model, hanging_model, linear_model
from training.environment.design import LAW, LOCK

OBSERVATION = (
    ObservationEntry.of("hole_offset_xy", scale=1e-3),
    ObservationEntry.of("height", scale=0.01),
    ObservationEntry.of("force_mean", scale=5.0),
)
EASY_SEED = 0
"""A seed of the easy conditions whose hole is where the camera says and turned by next to nothing."""


def document(**changes: object) -> PolicyContract:
    return contract(**({"observation": OBSERVATION, "compliance": LAW, "dsl": LOCK} | changes))


def save(path: Path, model: object) -> Path:
    path.write_bytes(model.SerializeToString())  # type: ignore[attr-defined]
    return path


def still(folder: Path, **changes: object) -> Path:
    """Asks for nothing: the lock's own search brings it down to the block."""
    asked = document(**changes)
    weights = np.zeros((asked.observation_size, len(asked.action)))
    return save(folder / "still.onnx", linear_model(asked, weights=weights))


def straight(folder: Path, **changes: object) -> Path:
    """Goes where the camera says that the hole is, and down: enough where the camera is right and the yaw is."""
    asked = document(**changes)
    weights = np.zeros((asked.observation_size, len(asked.action)))
    weights[0, 0] = weights[1, 1] = 500.0
    return save(folder / "straight.onnx", linear_model(asked, weights=weights))


def sideways(folder: Path, **changes: object) -> Path:
    """Pushes along x from the first contact on, wherever that leads."""
    asked = document(**({"observation": (ObservationEntry.of("contact_height_known"),)} | changes))
    weights = np.zeros((asked.observation_size, len(asked.action)))
    weights[0, 0] = 5.0
    return save(folder / "sideways.onnx", linear_model(asked, weights=weights))


def hanging(folder: Path, when: str, **changes: object) -> Path:
    """Asks for nothing and never ends: at every inference (`load`), the `first` one of a run, or a `later` one."""
    return save(folder / "hanging.onnx", hanging_model(document(hidden_size=1, **changes), when))


def not_a_number(folder: Path) -> Path:
    """Answers with NaN as soon as a run asks; the trial at loading does not show it."""
    return save(folder / "nan.onnx", failing_model(document(hidden_size=1)))


def pressing(folder: Path, **changes: object) -> Path:
    """Comes down where it is, and from the first contact on asks for as much depth as the action allows."""
    asked = document(observation=(*OBSERVATION, ObservationEntry.of("contact_height_known")), **changes)
    weights = np.zeros((asked.observation_size, len(asked.action)))
    weights[-1, 2] = -20.0
    return save(folder / "pressing.onnx", linear_model(asked, weights=weights))


def greedy(folder: Path) -> Path:
    """Wants more memory than a machine has to spare."""
    return save(folder / "greedy.onnx", greedy_model(document(hidden_size=1)))
