"""One test per fault that a cell must survive, by what the arm does and what the record says."""

import asyncio
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from service.cell import watch
from service.config import ClientLossSection
from service.drivers.base import Program, Sample, StopReason
from service.faults import FaultCode
from service.messages import CellState, RefusalReason, Refused, ResetRequest, RunState, StatusResult, StopRequest
from service.testing import cell_config, lockstep_cell
from tests.service.cell import policies
from tests.service.cell.conftest import EASY, FaultyBench, FaultyCell
from tests.service.cell.faulty_driver import Spoil, speed, with_wrench
from wire import pose

TICK_S = 0.002


def once(spoil: Spoil) -> Spoil:
    """Spoil one sample, pass the others on."""
    done: list[bool] = []

    def maybe(sample: Sample) -> Sequence[Sample]:
        if done:
            return [sample]
        done.append(True)
        return spoil(sample)

    return maybe


async def spoil_and_time(faulty: FaultyBench, spoil: Spoil) -> float:
    """Spoil the next sample; return when, by the driver's clock."""
    faulty.driver.spoil = spoil
    return faulty.driver.clock()


@pytest.mark.parametrize("axis", ["fx", "fy", "fz"])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
async def test_01_force_ceiling_crossed_on_one_sample_force_ceiling(
    faulty_cell: FaultyCell, axis: str, sign: float
) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()
        at = await spoil_and_time(faulty, once(lambda sample: [with_wrench(sample, **{axis: sign * 30.5})]))
        ended = await faulty.assert_latched(run, FaultCode.FORCE_CEILING)
        assert ended.peak_force_n >= 30.5
        stop = next(time_s for time_s in faulty.driver.said("stop") if time_s > at)
        assert stop <= at + 1.5 * TICK_S, "the stop leaves within the tick of the sample"


async def test_03_a_step_between_two_policy_ticks_trips_on_the_sample_force_ceiling(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()
        steps = len(faulty.bench.records)
        await faulty.bench.let_pass(0.02)
        assert len(faulty.bench.records) == steps, "a policy step has 80 ms, this is in the middle of one"
        at = await spoil_and_time(faulty, once(lambda sample: [with_wrench(sample, fz=45.0)]))
        await faulty.assert_latched(run, FaultCode.FORCE_CEILING)
        assert next(time_s for time_s in faulty.driver.said("stop") if time_s > at) <= at + 1.5 * TICK_S
        assert len(faulty.bench.records) == steps


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), float("-inf")])
async def test_04_nan_in_one_channel_sensor_invalid(faulty_cell: FaultyCell, bad: float) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()
        await spoil_and_time(faulty, lambda sample: [with_wrench(sample, ty=bad)])
        await faulty.bench.let_pass(0.01)
        faulty.driver.spoil = lambda sample: [sample]
        await faulty.assert_latched(run, FaultCode.SENSOR_INVALID)
        assert all(np.isfinite(record.observation).all() for record in faulty.bench.records)


async def test_05_frozen_samples_with_fresh_stamps_sensor_stuck(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()
        frozen = faulty.driver.truth.wrench.copy()
        at = await spoil_and_time(faulty, lambda sample: [replace(sample, wrench=frozen)])
        await faulty.bench.state(CellState.STOPPING)
        faulty.driver.spoil = lambda sample: [sample]
        await faulty.assert_latched(run, FaultCode.SENSOR_STUCK)
        stop = next(time_s for time_s in faulty.driver.said("stop") if time_s > at)
        assert stop <= at + faulty.bench.cell.config.limits.stuck_samples * TICK_S


async def test_06_a_saturated_sensor_counts_as_above_the_ceiling_force_ceiling(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()
        await spoil_and_time(faulty, once(lambda sample: [replace(sample, saturated=True)]))
        await faulty.assert_latched(run, FaultCode.FORCE_CEILING)


async def test_11_samples_stop_stale_at_the_age_limit(faulty_cell: FaultyCell) -> None:
    async with faulty_cell(real_time=True) as faulty:
        run = await faulty.running()
        await spoil_and_time(faulty, lambda sample: [])
        last = faulty.bench.cell.newest_sample.arrival_s
        await faulty.bench.state(CellState.STOPPING)
        stop = next(time_s for time_s in faulty.driver.said("stop") if time_s > last)
        limit = faulty.bench.cell.config.limits.sample_age_s
        assert abs(stop - (last + limit)) <= 1.01 * TICK_S
        await faulty.bench.state(CellState.LATCHED)
        assert "no standstill was measured" in faulty.bench.cell.journal.latch.text
        assert faulty.bench.cell.journal.latch.code is FaultCode.STALE
        assert faulty.bench.cell.runs.find(run.id).code is FaultCode.STALE
        assert speed(faulty.driver.truth) < 2e-3, "it stands, though the cell cannot see it"
        answer = await faulty.bench.cell.reset(ResetRequest())
        assert isinstance(answer, Refused)
        assert answer.problem.reason is RefusalReason.NO_MEASUREMENT


async def test_12_latency_jumps_to_100_ms_stale(faulty_cell: FaultyCell) -> None:
    async with faulty_cell(real_time=True) as faulty:
        run = await faulty.running()
        late: list[Sample] = []

        def delay(sample: Sample) -> Sequence[Sample]:
            late.append(sample)
            return [replace(late.pop(0), arrival_s=sample.arrival_s)] if len(late) > 50 else []

        await spoil_and_time(faulty, delay)
        await faulty.bench.state(CellState.LATCHED)
        assert faulty.bench.cell.runs.find(run.id).code is FaultCode.STALE
        assert speed(faulty.driver.truth) < 2e-3


async def test_13_duplicates_and_older_samples_are_ignored(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()
        before: list[Sample] = [faulty.driver.truth]

        def repeat(sample: Sample) -> Sequence[Sample]:
            before.append(sample)
            return [sample, sample, before[-2]]

        await spoil_and_time(faulty, repeat)
        ended = await faulty.bench.ended(run)
        assert ended.state is RunState.SUCCEEDED
        assert faulty.bench.cell.status().counters.samples_ignored > 1000


async def test_13_duplicates_do_not_refresh_the_age_stale(faulty_cell: FaultyCell) -> None:
    async with faulty_cell(real_time=True) as faulty:
        run = await faulty.running()
        held = faulty.driver.truth
        await spoil_and_time(faulty, lambda sample: [replace(held, arrival_s=sample.arrival_s)])
        await faulty.bench.state(CellState.LATCHED)
        assert faulty.bench.cell.runs.find(run.id).code is FaultCode.STALE


async def test_14_the_arms_clock_steps_back_and_nothing_depends_on_it(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()
        await spoil_and_time(faulty, lambda sample: [replace(sample, time_s=sample.time_s - 5.0)])
        await faulty.bench.let_pass(0.5)
        assert faulty.bench.cell.journal.latch is None
        assert (await faulty.bench.ended(run)).state is RunState.SUCCEEDED


async def test_15_what_the_driver_cannot_read_protocol(faulty_cell: FaultyCell) -> None:
    async with faulty_cell(real_time=True) as faulty:
        run = await faulty.running()
        faulty.driver.on_link_fault(FaultCode.PROTOCOL, "17 bytes are not a state")
        await faulty.assert_latched(run, FaultCode.PROTOCOL)


async def test_21_a_source_that_comes_back_as_another_is_not_resumed_link(faulty_cell: FaultyCell) -> None:
    async with faulty_cell(real_time=True, limits={"sample_age_s": 0.5, "target_age_s": 1.0}) as faulty:
        run = await faulty.running()
        await spoil_and_time(faulty, lambda sample: [])
        await faulty.bench.let_pass(0.45)
        await spoil_and_time(faulty, lambda sample: [replace(sample, epoch=sample.epoch + 1)])
        await faulty.bench.state(CellState.LATCHED)
        assert faulty.bench.cell.runs.find(run.id).code in (FaultCode.LINK, FaultCode.SOURCE, FaultCode.STALE)
        targets = len(faulty.driver.said("target"))
        await faulty.bench.let_pass(1.0)
        assert faulty.bench.cell.state is CellState.LATCHED
        assert len(faulty.driver.said("target")) == targets


async def test_22_two_publishers_source(faulty_cell: FaultyCell) -> None:
    async with faulty_cell(real_time=True) as faulty:
        run = await faulty.running()
        await spoil_and_time(faulty, once(lambda sample: [sample, replace(sample, epoch=sample.epoch + 1)]))
        await faulty.assert_latched(run, FaultCode.SOURCE)


async def test_22_a_world_laid_out_anew_under_a_run_source(faulty_cell: FaultyCell) -> None:
    async with faulty_cell(real_time=True) as faulty:
        run = await faulty.running()
        await spoil_and_time(faulty, once(lambda sample: [replace(sample, episode=sample.episode + 1)]))
        await faulty.assert_latched(run, FaultCode.SOURCE)


async def test_30_a_target_that_jumps_is_rejected_by_the_arm_bounds(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()
        record = faulty.bench.records[-1]
        jump = replace(record.target, position=record.target.position + np.array([0.02, 0.0, 0.0]))
        before = faulty.driver.truth.tcp_position
        faulty.driver.send_target(jump)
        await faulty.assert_latched(run, FaultCode.BOUNDS)
        assert np.abs(faulty.driver.truth.tcp_position - before).max() < 5e-3, "it did not go there"


def tilted(sample: Sample, by_rad: float) -> Sample:
    """The sample with its tool leaning over about the base frame's x axis."""
    turn = np.array([[1, 0, 0], [0, np.cos(by_rad), -np.sin(by_rad)], [0, np.sin(by_rad), np.cos(by_rad)]])
    rotation = turn @ pose.rotation_from_rotvec(sample.tcp_rotvec)
    return replace(sample, tcp_rotvec=pose.rotvec_from_rotation(rotation))


async def test_a_tool_tilted_beyond_its_limit_gets_no_target_and_latches_bounds(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()
        limit = faulty.bench.cell.config.limits.max_tilt_rad
        sent = len(faulty.driver.said("target"))
        await spoil_and_time(faulty, lambda sample: [tilted(sample, 1.5 * limit)])
        ended = await faulty.assert_latched(run, FaultCode.BOUNDS)
        assert len(faulty.driver.said("target")) == sent
        assert f"limit {limit:g} rad" in ended.text
        assert float(ended.text.split("tilted by ")[1].split(" rad")[0]) == pytest.approx(1.5 * limit, abs=0.02)


async def test_31_the_arm_cannot_follow_kinematics(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()

        def stopped(sample: Sample) -> Sequence[Sample]:
            return [replace(sample, program=Program.STOPPING, stop_reason=StopReason.KINEMATICS)]

        await spoil_and_time(faulty, once(stopped))
        await faulty.assert_latched(run, FaultCode.KINEMATICS)


async def test_33_a_protective_stop_latches_here_too_protective_stop(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()
        await spoil_and_time(faulty, once(lambda sample: [replace(sample, program=Program.PROTECTIVE_STOP)]))
        await faulty.assert_latched(run, FaultCode.PROTECTIVE_STOP)


async def test_35_control_of_the_arm_is_lost_authority(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()
        await spoil_and_time(faulty, once(lambda sample: [replace(sample, robot_mode=5)]))
        await faulty.assert_latched(run, FaultCode.AUTHORITY)


async def test_touching_something_at_the_start_fails_the_run_unmoved_contact_at_start(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        faulty.driver.spoil = lambda sample: [with_wrench(sample, fz=sample.wrench[2] + 5.0)]
        run = await faulty.bench.insert(EASY)
        assert (run.state, run.code) == (RunState.FAILED, FaultCode.CONTACT_AT_START)
        assert faulty.driver.said("engage") == []
        assert faulty.bench.cell.state is CellState.READY


async def test_43_a_reset_while_the_force_is_above_the_limit_is_refused(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()
        faulty.driver.spoil = lambda sample: [with_wrench(sample, fx=40.0 + sample.wrench[0])]
        await faulty.bench.state(CellState.LATCHED)
        answer = await faulty.bench.cell.reset(ResetRequest())
        assert isinstance(answer, Refused)
        assert answer.problem.reason is RefusalReason.FORCE_ABOVE_LIMIT
        assert faulty.bench.cell.state is CellState.LATCHED
        faulty.driver.spoil = lambda sample: [sample]
        await faulty.bench.let_pass(0.05)
        assert isinstance(await faulty.bench.cell.reset(ResetRequest()), StatusResult)
        assert faulty.bench.cell.runs.find(run.id).code is FaultCode.FORCE_CEILING


def with_client(faulty: FaultyBench) -> Spoil:
    """Spoils nothing; a client is heard with every sample."""

    def heard(sample: Sample) -> Sequence[Sample]:
        faulty.bench.cell.hear_client()
        return [sample]

    return heard


async def test_36_a_client_that_falls_silent_stops_the_run_where_that_is_asked_for_client_lost(
    faulty_cell: FaultyCell,
) -> None:
    loss = ClientLossSection(policy="stop", limit_s=0.3)
    async with faulty_cell(real_time=True, client_loss=loss) as faulty:
        faulty.driver.spoil = with_client(faulty)
        run = await faulty.running()
        silent_from = await spoil_and_time(faulty, lambda sample: [sample])
        await faulty.bench.state(CellState.STOPPING)
        assert faulty.driver.clock() - silent_from == pytest.approx(loss.limit_s, abs=2 * TICK_S)
        ended = await faulty.assert_latched(run, FaultCode.CLIENT_LOST)
        assert ended.state is RunState.STOPPED


async def test_a_client_that_is_heard_lets_the_run_go_on_and_an_idle_cell_needs_none(faulty_cell: FaultyCell) -> None:
    async with faulty_cell(real_time=True, client_loss=ClientLossSection(policy="stop", limit_s=0.2)) as faulty:
        await faulty.bench.let_pass(0.5)
        assert faulty.bench.cell.state is CellState.READY
        faulty.driver.spoil = with_client(faulty)
        assert (await faulty.bench.insert(EASY)).state is RunState.SUCCEEDED


async def test_by_default_a_run_goes_on_without_its_client(faulty_cell: FaultyCell) -> None:
    async with faulty_cell(real_time=True, client_loss=ClientLossSection(limit_s=0.2)) as faulty:
        assert (await faulty.bench.insert(EASY)).state is RunState.SUCCEEDED


async def test_50_a_loop_that_is_late_again_and_again_latches_a_run_overrun(faulty_cell: FaultyCell) -> None:
    async with faulty_cell(real_time=True) as faulty:
        run = await faulty.running()
        faulty.bench.cell.lateness.limit_s = -1.0  # every turn counts as late
        watching = asyncio.create_task(watch.keep_watch(faulty.bench.cell))
        ended = await faulty.assert_latched(run, FaultCode.OVERRUN)
        assert ended.state is RunState.LATCHED
        watching.cancel()


async def test_50_a_loop_that_is_late_while_nothing_runs_is_counted_only(faulty_cell: FaultyCell) -> None:
    async with faulty_cell(real_time=True) as faulty:
        faulty.bench.cell.lateness.limit_s = -1.0
        watching = asyncio.create_task(watch.keep_watch(faulty.bench.cell))
        await faulty.bench.until(lambda: faulty.bench.cell.lateness.overruns > 2 * watch.OVERRUNS_IN_A_ROW)
        assert faulty.bench.cell.state is CellState.READY
        assert faulty.bench.cell.journal.latch is None
        watching.cancel()


async def test_45_the_arm_accepts_a_stop_and_moves_on_stop_unconfirmed(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        faulty.driver.deaf_to_stop = True
        run = await faulty.bench.start(EASY)
        await faulty.bench.state(CellState.APPROACH)
        await faulty.bench.let_pass(0.2)
        at = faulty.driver.clock()
        await spoil_and_time(faulty, once(lambda sample: [with_wrench(sample, fz=35.0)]))
        await faulty.bench.state(CellState.LATCHED)
        latch = faulty.bench.cell.journal.latch
        assert latch.code is FaultCode.STOP_UNCONFIRMED
        assert "FORCE_CEILING" in latch.text
        assert faulty.bench.cell.runs.find(run.id).code is FaultCode.FORCE_CEILING
        asked = [time_s for time_s in faulty.driver.said("stop") if time_s > at]
        assert len(asked) > 20, "it is asked again and again"
        escalated = faulty.driver.said("escalate")
        assert len(escalated) == 1
        assert escalated[0] - at >= faulty.bench.cell.config.limits.stop_confirm_s, "the last resort comes last"
        faulty.driver.deaf_to_stop = False
        faulty.driver.stop()


async def test_53_a_control_process_that_died_leaves_its_run_interrupted_and_the_cell_latched(tmp_path: Path) -> None:
    config = cell_config(tmp_path / "state", policies.still(tmp_path))
    async with lockstep_cell(config) as bench:
        run = await bench.start()
        image = {path.name: path.read_bytes() for path in (tmp_path / "state").iterdir()}
    (tmp_path / "after").mkdir()
    for name, content in image.items():
        (tmp_path / "after" / name).write_bytes(content)
    async with lockstep_cell(cell_config(tmp_path / "after", policies.still(tmp_path))) as bench:
        assert bench.cell.state is CellState.LATCHED
        assert bench.cell.journal.latch.code is FaultCode.INTERRUPTED
        assert bench.cell.journal.latch.peak_force_n is None, "nobody knows it any more"
        assert bench.cell.runs.find(run.id).state is RunState.INTERRUPTED


async def test_54_power_cycle_while_latched_starts_latched(faulty_cell: FaultyCell, tmp_path: Path) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()
        await spoil_and_time(faulty, once(lambda sample: [with_wrench(sample, fz=45.0)]))
        await faulty.assert_latched(run, FaultCode.FORCE_CEILING)
    config = cell_config(tmp_path / "state", policies.straight(tmp_path), conditions="easy")
    async with lockstep_cell(config) as bench:
        assert bench.cell.state is CellState.LATCHED
        assert bench.cell.journal.latch.code is FaultCode.FORCE_CEILING
        with pytest.raises(AssertionError, match="refused, LATCHED"):
            await bench.start()
        assert isinstance(await bench.cell.reset(ResetRequest()), StatusResult)
    async with lockstep_cell(config) as bench:
        assert bench.cell.state is CellState.READY


async def test_51_a_full_disk_refuses_starts_and_a_stop_works(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()
        bench, ledger = faulty.bench, faulty.bench.cell.journal._ledger
        full = os.open("/dev/full", os.O_WRONLY)
        whole = os.dup(ledger._file.fileno())
        os.dup2(full, ledger._file.fileno())
        bench.cell.stop(StopRequest())
        await bench.state(CellState.LATCHED)
        assert speed(faulty.driver.truth) < 2e-3
        assert bench.cell.runs.find(run.id).state is RunState.STOPPED
        assert isinstance(await bench.cell.reset(ResetRequest()), StatusResult), "the latch has a file of its own"
        with pytest.raises(AssertionError, match=r"STORAGE.*No space left"):
            await bench.start()
        assert len(faulty.driver.said("engage")) == 1
        assert bench.cell.state is CellState.READY
        os.dup2(whole, ledger._file.fileno())
        os.close(full)
        os.close(whole)


async def test_an_error_of_ours_in_the_loop_stops_and_latches_internal(
    faulty_cell: FaultyCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()

        def fail(*_: object) -> None:
            raise ZeroDivisionError("ours")

        monkeypatch.setattr("service.safety.seating.Seating.observe", fail)
        ended = await faulty.assert_latched(run, FaultCode.INTERNAL)
        assert "ZeroDivisionError" in ended.text


async def test_an_idle_cell_that_hears_nothing_is_offline_and_comes_back_by_itself(faulty_cell: FaultyCell) -> None:
    async with faulty_cell(real_time=True) as faulty:
        faulty.driver.spoil = lambda sample: []
        await faulty.bench.state(CellState.OFFLINE, CellState.CONNECTING)
        assert not faulty.bench.cell.status().can_start
        assert faulty.bench.cell.journal.latch is None
        faulty.driver.spoil = lambda sample: [sample]
        await faulty.bench.state(CellState.READY)
