"""A small untrained policy as a cell would load it, for what needs one."""

from pathlib import Path
from typing import Any

import pytest

from tests.training.play import SHORT


@pytest.fixture(scope="session")
def untrained() -> Any:
    """A stable-baselines3 model on two cells, as `training.learn` builds it."""
    pytest.importorskip("torch", reason="needs the extra `training`: pip install -e '.[training]'")
    from training.episodes import TaskSource
    from training.learn import Recipe, build

    return build(SHORT, TaskSource(), Recipe(cells=2, workers=1, rollout=8, batch=16, hidden=(32, 32)))


@pytest.fixture(scope="session")
def model_path(untrained: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same as an ONNX file."""
    pytest.importorskip("onnx", reason="needs the extra `training`")
    from training.export import export

    path = tmp_path_factory.mktemp("model") / "untrained.onnx"
    export(untrained, SHORT, path)
    return path
