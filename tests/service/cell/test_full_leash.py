"""A run that ends with its target at the end of its leash ends for its own reason, not for a rejected target."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from service.drivers.base import PoseTarget, Sample
from service.faults import FaultCode
from service.messages import CellState, RunState
from tests.service.cell import policies
from tests.service.cell.conftest import EASY, FaultyCell
from tests.service.policy.model_files import ACTION
from training.environment.design import LAW

FAR = tuple(entry.model_copy(update={"limit": 0.05}) if entry.unit == "m" else entry for entry in ACTION)
"""Actions that ask for more than any bound allows, so that the target runs ahead to the end of its leash."""


@pytest.mark.parametrize("way", [0, 1], ids=["x", "y"])
async def test_a_run_that_fails_at_full_leash_fails_and_does_not_latch(
    faulty_cell: FaultyCell, tmp_path: Path, way: int
) -> None:
    slow = replace(LAW, damping=(2000.0, 2000.0, 2000.0, *LAW.damping[3:]))
    document = policies.document(observation=(policies.ObservationEntry.of("height", scale=1e-3),), action=FAR)
    document = document.model_copy(update={"dsl": replace(document.dsl, mode="off"), "compliance": slow})
    weights = np.zeros((document.observation_size, len(document.action)))
    weights[0, way], weights[0, 2], weights[0, 3] = 10.0, -10.0, 10.0
    policy = policies.save(tmp_path / "far.onnx", policies.linear_model(document, weights=weights))
    async with faulty_cell(policy, allow_lock=("off",), max_steps=4, limits={"clamped_steps": 20}) as faulty:
        driver = faulty.driver
        sent: list[tuple[PoseTarget, Sample]] = []
        send = driver.send_target

        def note(target: PoseTarget) -> int:
            sent.append((target, driver.truth))
            return send(target)

        driver.send_target = note
        run = await faulty.bench.insert(EASY)
        assert (run.state, run.code) == (RunState.FAILED, FaultCode.SEARCH_LIMIT), run.text
        assert run.text == "not inserted within 4 steps"
        assert faulty.bench.cell.state is CellState.READY
        last = max(i for i, (target, _) in enumerate(sent) if target is faulty.bench.records[-1].target)
        (target, measured), (back, _) = sent[last], sent[last + 1]
        limit_m = faulty.bench.cell.config.limits.max_step_m
        assert np.linalg.norm(target.position - measured.tcp_position) > 0.9 * limit_m, "at the end of its leash"
        assert np.linalg.norm(back.position - target.position) <= limit_m
