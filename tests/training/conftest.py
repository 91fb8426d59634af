"""Small untrained policies as a cell would load them, for what needs one."""

from pathlib import Path
from typing import Any

import pytest

from tests.training.play import REMEMBERING, SHORT


def network(contract: Any) -> Any:
    """An untrained network; its head is let out, so that its actions differ from zero."""
    torch = pytest.importorskip("torch", reason="needs the extra `training`: pip install -e '.[training]'")
    from training.learning.network import ActorCritic

    torch.manual_seed(0)
    made = ActorCritic(contract, 32, 32, -0.7)
    with torch.no_grad():
        made.head[-1].weight *= 20.0
    return made


@pytest.fixture(scope="session")
def untrained() -> Any:
    """Without a memory."""
    return network(SHORT)


@pytest.fixture(scope="session")
def remembering() -> Any:
    """With a recurrent unit."""
    return network(REMEMBERING)


@pytest.fixture(scope="session")
def model_path(untrained: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The one without a memory as an ONNX file."""
    pytest.importorskip("onnx", reason="needs the extra `training`")
    from training.learning.export import export

    path = tmp_path_factory.mktemp("model") / "untrained.onnx"
    export(untrained, SHORT, path)
    return path
