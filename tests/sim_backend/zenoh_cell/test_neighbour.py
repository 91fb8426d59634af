"""A simulated cell in real time leaves the other programs of its host their share."""

import os

import pytest

from sim_backend.world import arm
from sim_backend.zenoh_cell import rest as rest_module
from sim_backend.zenoh_cell.cell import SimulatedCell
from sim_backend.zenoh_cell.rest import QUIET_TICKS, RESTING_TICKS, Rest
from sim_backend.zenoh_cell.server import Pace, Server
from tests.scheduling import ORDINARY, schedulings
from tests.sim_backend.zenoh_cell.test_server import Client, States, command, real_time, served
from wire import realtime, records
from wire.arrays import RecordArray
from wire.session import open_session
from wire.task import Task

__all__ = ["real_time"]


def test_a_simulator_has_ordinary_priority_unless_asked_and_is_below_a_control_process_then(
    free_endpoint: str,
) -> None:
    with served(free_endpoint) as (process, _):
        assert schedulings(process.popen.pid) == {ORDINARY}
        process.end()
    with served(free_endpoint, "--realtime") as (process, client):
        if client.info()["degraded"]:
            pytest.skip("this host grants no real-time scheduling")
        assert max(schedulings(process.popen.pid)) == (os.SCHED_FIFO, realtime.SIMULATOR_PRIORITY)
    assert realtime.SIMULATOR_PRIORITY < realtime.PRIORITY


def test_rest_begins_when_nothing_has_happened_for_a_while_and_ends_at_once() -> None:
    rest = Rest()
    quiet = [False] * (QUIET_TICKS - 1)
    for disturbed in (*quiet, True, *quiet):
        rest.note(disturbed=disturbed)
        assert rest.ticks == 1
    rest.note(disturbed=False)
    assert rest.ticks == RESTING_TICKS
    rest.note(disturbed=True)
    assert rest.ticks == 1


def test_a_world_rests_while_nothing_drives_it_and_a_command_wakes_it(real_time: Client) -> None:
    states = States(real_time.session)
    start = real_time.reset(seed=3)[0]
    states.until(lambda _: RESTING_TICKS in states.steps())
    epoch = int(start["epoch"])
    real_time.send(command(records.Kind.ENGAGE, epoch, 1, start))
    engaged = states.until(lambda state: state["program"] == records.Program.ENGAGED)
    states.until(lambda state: state["seq"] > engaged["seq"] + 100)
    assert set(states.steps(engaged["seq"])) == {1}
    real_time.send(command(records.Kind.STOP, epoch, 2, start))
    states.until(lambda state: state["stop_reason"] == records.StopReason.COMMAND)


class EngagedCell(SimulatedCell):
    """A cell whose arm is engaged for a hundred ticks, then stopped. It ends when it was told to rest."""

    def __init__(self) -> None:
        super().__init__()
        state = self.reset(Task(3))[0]
        self._asked = [command(kind, self.epoch, 1, state)[0, ...] for kind in (records.Kind.ENGAGE, records.Kind.STOP)]
        self.apply(self._asked[0])
        self.passed: list[tuple[records.Program, int]] = []

    def tick(self, ticks: int = 1) -> RecordArray:
        state = super().tick(ticks)
        self.passed.append((records.Program(int(state["program"][0])), ticks))
        if len(self.passed) == 100:
            self.apply(self._asked[1])
        if ticks > 1:
            raise KeyboardInterrupt
        return state


def test_a_world_is_awake_while_its_arm_is_driven(free_endpoint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rest_module, "QUIET_TICKS", 20)
    cell = EngagedCell()
    with open_session([free_endpoint]) as session, pytest.raises(KeyboardInterrupt):
        Server(cell, session, "world-1", Pace.REAL_TIME).run()
    driven = [ticks for program, ticks in cell.passed if program is not records.Program.IDLE]
    assert len(driven) > 100
    assert set(driven) == {1}
    assert cell.passed[-1] == (records.Program.IDLE, RESTING_TICKS)


class HaltedCell(SimulatedCell):
    """A cell in its protective stop. It asks for the release as soon as the shortest stop is over by its own clock."""

    def __init__(self) -> None:
        super().__init__()
        state = self.reset(Task(3))[0]
        self._unlock = command(records.Kind.UNLOCK, self.epoch, 1, state)[0, ...]
        self.world.arm.program[0] = records.Program.PROTECTIVE_STOP
        self._since_s = float(state["time_s"])
        self.released: bool | None = None

    def tick(self, ticks: int = 1) -> RecordArray:
        state = super().tick(ticks)
        if float(state["time_s"][0]) - self._since_s > arm.MIN_PROTECTIVE_STOP_S:
            self.apply(self._unlock)
            self.released = bool(self.world.arm.program[0] == records.Program.IDLE)
            raise KeyboardInterrupt
        return state


def test_a_protective_stop_lasts_no_longer_for_a_world_that_is_left_alone(
    free_endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rest_module, "QUIET_TICKS", 20)
    monkeypatch.setattr(arm, "MIN_PROTECTIVE_STOP_S", 0.4)
    cell = HaltedCell()
    with open_session([free_endpoint]) as session, pytest.raises(KeyboardInterrupt):
        Server(cell, session, "world-1", Pace.REAL_TIME).run()
    assert cell.released
