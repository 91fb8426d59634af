"""Row 56: an edit of the configuration's file changes nothing in a run, and bars the next one."""

from pathlib import Path

import pytest
from pydantic import ValidationError

from service.config import CellConfig, load
from service.faults import FaultCode
from service.messages import CellState, RunState, StartRequest
from service.testing import lockstep_cell
from tests.service.cell import policies
from wire.limits import MAX_SPEED

SEED = 1
NAME = "triangle-2mm"
ROOT = Path(__file__).parents[3]


@pytest.fixture
def config(tmp_path: Path) -> CellConfig:
    policies.straight(tmp_path)
    text = (ROOT / "config" / "cell.toml").read_text()
    path = tmp_path / "cell.toml"
    path.write_text(
        text.replace("../models/vftm-dsl.onnx", "straight.onnx")
        .replace("../var/cell-1", "state")
        .replace('part = "tr"', 'part = "tr"\nmax_steps = 10')
    )
    return load(path)


async def test_56_limits_edited_in_a_run_do_not_reach_it_and_bar_the_next_one(config: CellConfig) -> None:
    assert config.source is not None
    file = config.source.path
    before = file.read_text()
    async with lockstep_cell(config) as bench:
        started = await bench.start(SEED, recipe=NAME)
        await bench.state(CellState.RUNNING)
        file.write_text(before.replace("force_ceiling_n = 30.0", "force_ceiling_n = 50.0\nmax_speed_m_s = 0.25"))
        ended = await bench.ended(started)
        assert (ended.state, ended.code) == (RunState.FAILED, FaultCode.SEARCH_LIMIT)
        assert bench.cell.status().force_ceiling_n == 30.0
        assert bench.cell.config.limits.max_speed_m_s == MAX_SPEED[0]
        with pytest.raises(AssertionError, match=r"WRONG_STATE: .*cell\.toml was edited .* \(in limits\)"):
            await bench.start(SEED, recipe=NAME)
        assert bench.cell.state is CellState.READY
        assert len(bench.cell.journal.newest(10)) == 1
        file.write_text("# a comment changes nothing\n" + before)
        await bench.start(SEED, recipe=NAME)


async def test_56_a_file_that_is_gone_or_no_toml_any_more_bars_a_start(config: CellConfig) -> None:
    assert config.source is not None
    async with lockstep_cell(config) as bench:
        for spoil in (lambda path: path.write_text("[cell"), lambda path: path.unlink()):
            spoil(config.source.path)
            with pytest.raises(AssertionError, match=r"WRONG_STATE: .*cell\.toml can no longer be read"):
                await bench.start(SEED, recipe=NAME)


def test_56_no_request_carries_a_limit_and_no_limit_in_force_can_be_set(config: CellConfig) -> None:
    with pytest.raises(ValidationError, match="force_ceiling_n"):
        StartRequest.model_validate({"recipe": NAME, "force_ceiling_n": 50.0})
    with pytest.raises(ValidationError, match="frozen"):
        config.limits.force_ceiling_n = 50.0
