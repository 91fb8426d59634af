from typing import Any

import numpy as np
import numpy.typing as npt
from mujoco import MjData, MjModel

class SimulationError(RuntimeError):
    ids: npt.NDArray[np.intp]

class Batch:
    model: MjModel
    nsim: int
    nthread: int
    nstate: int
    persistent: bool
    state: npt.NDArray[np.float64]
    warning: npt.NDArray[np.int32]
    status: npt.NDArray[Any]
    def __init__(self, model: MjModel, nsim: int, nthread: int = ..., persistent: bool = ...) -> None: ...
    def bind(self, name: str) -> npt.NDArray[Any]: ...
    def expand(self, name: str) -> npt.NDArray[Any]: ...
    def get_model(self, sim: int) -> MjModel: ...
    def get_data(self, sim: int) -> MjData: ...
    def __getattr__(self, name: str) -> Any: ...
    def __setattr__(self, name: str, value: Any) -> None: ...
