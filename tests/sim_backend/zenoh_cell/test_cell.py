import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sim_backend.world import scene
from sim_backend.world.parts import PARTS
from sim_backend.world.world import World
from sim_backend.zenoh_cell.cell import SimulatedCell
from tests.sim_backend.world.compiled.twins import assert_equal, told
from tests.sim_backend.world.plants import EVERY
from wire.records import COMMAND, STATE, TICK_S, Kind, Program, StopReason, decode, new
from wire.task import Task

EPOCH = 77
CLIENT = 5


@pytest.fixture(scope="module")
def shared():
    return SimulatedCell(epoch=EPOCH)


@pytest.fixture
def cell(shared):
    shared.reset(Task(1))
    for _ in range(3):
        shared.tick()
    return shared


def command(kind, seq=1, client=CLIENT, epoch=EPOCH, **fields):
    record = new(COMMAND, kind)[0]
    record["client"], record["epoch"], record["seq"] = client, epoch, seq
    for name, value in fields.items():
        record[name] = value
    return record


def engage(seq=1, **fields):
    sane = {
        "stiffness": [2500, 2500, 3000, 5, 5, 8],
        "damping": [320, 320, 400, 1, 1, 0.5],
        "inertia": [2.5, 2.5, 2.5, 0.06, 0.06, 0.03],
        "max_speed": [0.1, 1.0],
        "max_step": [0.012, 0.3],
        "workspace": [[0.15, -0.26, 0.01], [0.45, 0.04, 0.40]],
        "force_ceiling": 30.0,
        "target_age": 0.5,
    }
    return command(Kind.ENGAGE, seq, **{**sane, **fields})


def target(cell, seq, shift=(0.0, 0.0, 0.0), **fields):
    state = cell.state()[0]
    where = {"position": state["target_position"] + shift, "rotvec": state["target_rotvec"]}
    return command(Kind.TARGET, seq, **{**where, **fields})


def engaged(cell):
    cell.apply(command(Kind.ZERO_FT))
    cell.apply(engage())
    assert program(cell) is Program.ENGAGED
    return cell


def program(cell):
    return Program(cell.state()["program"][0])


def reason(cell):
    return StopReason(cell.state()["stop_reason"][0])


def test_a_state_is_one_wire_record_with_the_tick_in_it(cell):
    before = cell.state()[0].copy()
    payload = cell.tick().tobytes()
    row = decode(payload, STATE)[0]
    assert row["kind"] == Kind.STATE
    assert row["epoch"] == EPOCH
    assert row["seq"] == before["seq"] + 1
    assert row["time_s"] == pytest.approx(before["time_s"] + TICK_S)
    rested = cell.tick(5)[0]
    assert rested["seq"] == row["seq"] + 1
    assert rested["time_s"] == pytest.approx(row["time_s"] + 5 * TICK_S)
    assert row["episode"] == before["episode"]
    assert row["robot_mode"] == 7
    assert row["safety_mode"] == 1
    assert np.isfinite(row["wrench"]).all()
    assert np.abs(row["ft_raw"]).max() > 1  # the payload hangs there


def test_the_sequence_goes_on_across_resets_and_the_episode_counts_them(cell):
    first = cell.state()[0].copy()
    second = cell.reset(Task(2))[0]
    assert second["seq"] == first["seq"]
    assert second["episode"] == first["episode"] + 1


def test_engage_then_targets_move_the_arm(cell):
    engaged(cell)
    start = cell.state()["tcp_position"][0].copy()
    for seq in range(2, 6):
        cell.apply(target(cell, seq, [0.0, 0.0, 0.005]))
        for _ in range(40):
            cell.tick()
        assert cell.state()["command_seq"][0] == seq
    assert cell.state()["tcp_position"][0, 2] > start[2] + 0.01
    assert cell.state()["client"][0] == CLIENT


def test_a_target_for_another_world_is_ignored(cell):
    engaged(cell)
    cell.apply(target(cell, 2, [0, 0, 0.005], epoch=EPOCH + 1))
    assert cell.state()["command_seq"][0] == 1
    cell.apply(engage(epoch=EPOCH + 1, seq=9))
    assert cell.state()["command_seq"][0] == 1


@pytest.mark.parametrize("seq", [0, 1, 5])
def test_an_old_or_repeated_target_is_ignored_and_does_not_renew_the_age(cell, seq):
    engaged(cell)
    cell.apply(target(cell, 5, [0, 0, 0.002]))
    for _ in range(200):
        cell.tick()
    held = cell.state()["target_position"][0].copy()
    cell.apply(target(cell, seq, [0, 0, 0.005]))
    assert program(cell) is Program.ENGAGED
    for _ in range(60):
        cell.tick()
    assert reason(cell) is StopReason.TARGET_AGE
    assert held[2] == pytest.approx(0.182)


def test_a_target_of_another_client_is_ignored_and_its_engage_ends_the_program(cell):
    engaged(cell)
    cell.apply(target(cell, 2, [0, 0, 0.005], client=CLIENT + 1))
    assert program(cell) is Program.ENGAGED
    assert cell.state()["command_seq"][0] == 1
    cell.apply(engage(seq=1, client=CLIENT + 1))
    assert program(cell) is Program.STOPPING
    assert reason(cell) is StopReason.LEASE


@pytest.mark.parametrize("field", ["position", "rotvec"])
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_a_target_that_is_no_pose_stops_the_program(cell, field, value):
    engaged(cell)
    cell.apply(target(cell, 2, **{field: [value, 0.0, 0.0]}))
    assert program(cell) is Program.STOPPING
    assert reason(cell) is StopReason.TARGET_REJECTED
    for _ in range(100):
        cell.tick()
    assert program(cell) is Program.IDLE


@pytest.mark.parametrize(
    "field", ["stiffness", "damping", "inertia", "max_speed", "max_step", "workspace", "force_ceiling", "target_age"]
)
@pytest.mark.parametrize("value", [np.nan, np.inf, -1e3])
def test_an_engage_with_a_number_that_no_law_can_have_is_ignored(cell, field, value):
    cell.apply(engage(**{field: value}))
    assert program(cell) is Program.IDLE
    assert cell.state()["client"][0] == 0


def test_stop_is_obeyed_from_anyone_in_any_epoch(cell):
    engaged(cell)
    cell.apply(command(Kind.STOP, seq=0, client=999, epoch=0))
    assert program(cell) is Program.STOPPING
    assert reason(cell) is StopReason.COMMAND
    cell.apply(target(cell, 99, [0, 0, 0.005]))
    assert program(cell) is Program.STOPPING
    for _ in range(150):
        cell.tick()
    assert program(cell) is Program.IDLE
    assert np.abs(cell.state()["tcp_velocity"][0]).max() < 2e-3


def test_the_sensor_is_zeroed_in_idle_and_not_while_engaged(cell):
    raw = cell.state()["wrench"][0].copy()
    assert np.abs(raw[:3]).max() > 0.5  # the bias of this seed
    for _ in range(300):
        cell.tick()
    cell.apply(command(Kind.ZERO_FT))
    zeroed = np.mean([cell.tick()["wrench"][0] for _ in range(200)], axis=0)
    assert np.abs(zeroed[:3]).max() < 0.4
    engaged_cell = engaged(cell)
    before = engaged_cell._world.sensor._zero.copy()
    for _ in range(5):
        engaged_cell.tick()
    engaged_cell.apply(command(Kind.ZERO_FT))
    assert (engaged_cell._world.sensor._zero == before).all()


def test_a_protective_stop_shows_and_is_unlocked_after_five_seconds(cell):
    engaged(cell)
    cell._world.arm.joints[0, 1] += 0.2  # the arm cannot follow such a jump
    cell.tick()
    assert program(cell) is Program.PROTECTIVE_STOP
    assert cell.state()["safety_mode"][0] == 3
    cell.apply(command(Kind.UNLOCK))
    assert program(cell) is Program.PROTECTIVE_STOP
    for _ in range(2500):
        cell.tick()
    cell.apply(engage(seq=2))
    assert program(cell) is Program.PROTECTIVE_STOP
    cell.apply(command(Kind.UNLOCK))
    assert program(cell) is Program.IDLE
    assert cell.state()["safety_mode"][0] == 1


def run(cell, task, ticks=400):
    states = [cell.reset(task).copy()]
    cell.apply(command(Kind.ZERO_FT))
    cell.apply(engage())
    for tick in range(ticks):
        if tick % 40 == 0:
            cell.apply(target(cell, 2 + tick, [0.001, -0.001, -0.008]))
        states.append(cell.tick().copy())
    return np.concatenate(states)


@pytest.mark.parametrize("part", ["tr", "cir"])
def test_the_same_seed_is_the_same_bytes(part):
    task = Task(11, part, randomise_plant=True)
    first = run(SimulatedCell(part, epoch=EPOCH), task)
    assert (first["program"] == Program.ENGAGED).any()
    assert run(SimulatedCell(part, epoch=EPOCH), task).tobytes() == first.tobytes()
    other = run(SimulatedCell(part, epoch=EPOCH), Task(12, part, randomise_plant=True))
    assert other.tobytes() != first.tobytes()


def test_a_used_cell_repeats_a_seed_but_for_its_counters():
    fresh = SimulatedCell(epoch=EPOCH)
    first = run(fresh, Task(11))
    run(fresh, Task(12), 137)
    again = run(fresh, Task(11))
    for name in STATE.names or ():
        if name not in ("seq", "time_s", "episode"):
            assert again[name].tobytes() == first[name].tobytes(), name


def test_a_reset_changes_the_part_and_refuses_nonsense(shared):
    shared.reset(Task(0, "cir"))
    assert shared.part == "cir"
    assert shared.truth()["task"]["part"] == "cir"
    with pytest.raises(ValueError, match="clearance_m"):
        shared.reset(Task(0, "cir", clearance_m=1.0))
    shared.reset(Task(0))
    assert shared.part == "tr"


def test_model_and_data_are_those_of_the_present_episode(shared):
    for clearance in (0.5e-3, 3e-3):
        shared.reset(Task(0, clearance_m=clearance))
        built = scene.build("tr", clearance)
        model, data = shared.model(), shared.data()
        mujoco.mj_kinematics(model, data)
        assert model.geom_pos[built.wall_geoms] == pytest.approx(built.model.geom_pos[built.wall_geoms], abs=1e-15)
        hole = data.mocap_pos[0]
        inner = data.geom_xpos[built.wall_geoms, :2] - hole[:2]
        reach = np.linalg.norm(inner, axis=1) - scene.WALL_HALF_THICKNESS_M
        assert reach == pytest.approx(PARTS["tr"].wall_reach + clearance, abs=1e-12)


def test_the_truth_is_the_truth(cell):
    truth = cell.truth()
    assert truth["depth"] == pytest.approx(truth["hole_position"][2] - 0.180, abs=1e-3)
    assert truth["force"] == pytest.approx(scene.PAYLOAD_KG * 9.81, abs=0.5)
    assert isinstance(truth["contained"], bool)


def sent(kinds):
    """Records of right length and header, and otherwise any bytes at all."""
    return st.tuples(kinds, st.binary(min_size=COMMAND.itemsize - 8, max_size=COMMAND.itemsize - 8), st.booleans())


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(sent(st.integers(0, 8)), min_size=1, max_size=6))
def test_no_bytes_raise_and_none_move_the_arm_of_an_idle_cell(cell, messages):
    shift = cell.state()["tcp_position"][0].copy()
    for kind, body, ours in messages:
        payload = bytearray(new(COMMAND, Kind.STOP)[0].tobytes()[:8] + body)
        payload[6:8] = kind.to_bytes(2, "little")
        record = decode(bytes(payload), COMMAND)[0].copy()
        if ours:
            record["epoch"] = EPOCH
        cell.apply(record)
        state = cell.tick()[0]
        assert np.isfinite(state["tcp_position"]).all()
    for _ in range(3):
        cell.tick()
    assert cell.state()["tcp_position"][0] == pytest.approx(shift, abs=2e-3)


numbers = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True), st.sampled_from([0.0, 0.3, -0.11, 0.18, np.pi, np.nan, np.inf])
)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(numbers, numbers, numbers, numbers), min_size=1, max_size=4))
def test_no_numbers_in_a_target_raise_or_leave_the_workspace(cell, poses):
    cell.apply(engage())
    for seq, (x, y, z, turn) in enumerate(poses):
        cell.apply(target(cell, seq + 2, position=[x, y, z], rotvec=[turn, 0.0, 0.0]))
        for _ in range(4):
            state = cell.tick()[0]
        inside = (state["target_position"] >= [0.15, -0.26, 0.01]).all()
        assert inside
        assert (state["target_position"] <= [0.45, 0.04, 0.40]).all()
        assert np.isfinite(state["tcp_position"]).all()


def test_a_reset_lays_out_the_errors_of_the_tasks_plant_as_every_world_does(shared):
    task = Task(3, plant=EVERY)
    shared.reset(Task.from_json(task.to_json()))
    world = World(1)
    world.reset(np.array([0]), [task])
    for _ in range(20):
        shared.tick()
        world.tick()
    assert_equal(told(shared.world), told(world), "the end")
    assert shared.truth()["task"] == task.to_json()
