"""Configurations of a cell with a UR arm, for tests."""

from pathlib import Path
from typing import Any

from service.config import CellConfig
from service.testing import cell_config
from sim_backend.world import scene

UR: dict[str, Any] = {
    "host": "127.0.0.24",
    "simulated": True,
    "payload_kg": scene.PAYLOAD_KG,
    "payload_com_m": (0.0, 0.0, scene.PAYLOAD_COM_M),
    "tcp_m": (0.0, 0.0, scene.TCP_OFFSET_M, 0.0, 0.0, 0.0),
}
CAMERA: dict[str, Any] = {"endpoint": "tcp/127.0.0.1:7448", "key": "under-test/camera"}
"""Says that there is one; `emulated` hands the driver its own, and nobody opens this endpoint."""


def ur_config(
    state_dir: Path = Path("state"),
    policy: Path = Path("policy.onnx"),
    *,
    ur: dict[str, Any] | None = None,
    limits: dict[str, Any] | None = None,
    **recipe: Any,
) -> CellConfig:
    """A cell with one recipe; `ur` and `limits` are the fields that differ."""
    config = cell_config(state_dir, policy, limits, **recipe)
    document = config.model_dump(exclude={"ur", "camera"})
    document["cell"]["driver"] = "ur"
    return CellConfig.model_validate(document | {"ur": UR | (ur or {}), "camera": CAMERA})
