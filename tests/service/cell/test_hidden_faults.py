"""Faults that hide: behind a zeroed sensor, a slow disk, a link that comes and goes, an arm that does not obey."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from service.drivers.base import Driver, Program
from service.faults import FaultCode
from service.messages import RunState
from service.testing import cell_config, lockstep_cell
from sim_backend.cell import SimulatedCell
from sim_backend.protocol.task import Task
from tests.service.cell import policies
from tests.service.cell.conftest import EASY, FaultyCell
from tests.service.cell.faulty_driver import FaultyDriver


class LoadedCell(SimulatedCell):
    """A world in which something has leaned on the tool since long before the run: the sensor carries it."""

    def __init__(self, load: Sequence[float]) -> None:
        super().__init__("tr")
        self._load = np.array(load)

    def reset(self, task: Task) -> np.ndarray:
        answer = super().reset(task)
        sensor = self._world.sensor
        sensor._bias[0] += self._load
        sensor._average[0] += self._load
        return answer


@pytest.mark.parametrize("load", [(20.0, 0, 0, 0, 0, 0), (0, 0, -22.0, 0, 0, 0), (0, 0, 0, 0, 0, 3.0)])
async def test_a_load_that_was_there_before_the_run_is_not_zeroed_away_contact_at_start(
    tmp_path: Path, load: Sequence[float]
) -> None:
    drivers: list[FaultyDriver] = []

    def wrap(driver: Driver) -> FaultyDriver:
        drivers.append(FaultyDriver(driver))
        return drivers[-1]

    config = cell_config(tmp_path / "state", policies.straight(tmp_path), conditions="easy")
    async with lockstep_cell(config, wrap=wrap, world=LoadedCell(load)) as bench:
        run = await bench.insert(EASY)
        assert (run.state, run.code) == (RunState.FAILED, FaultCode.CONTACT_AT_START)
        assert "before it is zeroed" in run.text
        assert drivers[0].said("zero_ft") == drivers[0].said("engage") == []


async def test_a_sensor_is_zeroed_only_while_the_arm_stands_and_rests(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        faulty.driver.spoil = lambda sample: [replace(sample, program=Program.STOPPING)]
        run = await faulty.bench.insert(EASY)
        assert (run.state, run.code) == (RunState.LATCHED, FaultCode.STOP_UNCONFIRMED)
        assert faulty.driver.said("zero_ft") == faulty.driver.said("engage") == []
