import math

import numpy as np
import pytest

from service.drivers.base import Program, StopReason
from service.drivers.ur.samples import ALIVE_S, OUTPUTS, ArrivalClock, Package, ProgramWatch, SampleReader
from service.faults import FaultCode
from service.safety.monitor import Monitor, MonitorParameters
from tests.service.drivers.ur.cells import UR, ur_config
from wire.pose import rotation_from_rotvec, rotvec_from_rotation

CRC = 77


def package(**fields) -> Package:
    still = Package(
        time_s=60.0,
        q=(0.0, -1.0, 1.0, 0.0, 1.0, 0.0),
        qd=(0.0,) * 6,
        tcp_pose=(0.3, -0.1, 0.2, math.pi, 0.0, 0.0),
        tcp_speed=(0.0,) * 6,
        tcp_force=(0.0,) * 6,
        ft_raw=(0.0,) * 6,
        felt=(1.0, 2.0, 3.0, 0.0, 0.0, 0.0),
        robot_mode=7,
        safety_mode=1,
        runtime_state=2,
        speed_fraction=1.0,
        payload_kg=0.93,
        payload_com=(0.0, 0.0, 0.05),
        tcp_offset=(0.0, 0.0, 0.19, 0.0, 0.0, 0.0),
        accepted=4,
        program=1,
        reason=0,
        crc=CRC,
        counter=10,
        handled=5,
        peak_force_n=3.0,
    )
    return still._replace(**fields)


def a_sample(running: bool = True, ur=None, **fields):
    config = ur_config(ur=ur or {}).ur
    return SampleReader(config).read(package(**fields), 1.0, running=running, episode=0, hole_estimate=None)


def test_the_recipe_has_one_name_for_each_field() -> None:
    assert len(OUTPUTS) == len(Package._fields)
    assert len(set(OUTPUTS)) == len(OUTPUTS)


@pytest.mark.parametrize("tcp", [(0.0, 0.0, 0.19, 0.0, 0.0, 0.0), (0.02, -0.03, 0.15, 0.3, -0.2, 0.9)])
def test_a_torque_about_the_flange_is_moved_to_the_tcp(tcp) -> None:
    """A force at the TCP alone has no torque there; about the flange it has the lever's."""
    rotvec = np.array([2.0, 1.5, -0.4])
    force = np.array([3.0, -4.0, 5.0])
    flange_rotation = rotation_from_rotvec(rotvec) @ rotation_from_rotvec(tcp[3:]).T
    lever = flange_rotation @ np.array(tcp[:3])
    felt = (*force, *np.cross(lever, force))
    pose = (0.3, 0.0, 0.2, *rotvec)
    moved = a_sample(ur={"tcp_m": tcp}, tcp_force=felt, tcp_pose=pose).wrench
    assert moved == pytest.approx([*force, 0.0, 0.0, 0.0], abs=1e-12)
    kept = a_sample(ur={"tcp_m": tcp, "torque_about": "tcp"}, tcp_force=felt, tcp_pose=pose).wrench
    assert kept == pytest.approx(felt)


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.19, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.5, 0.4, -0.3)])
def test_09_the_load_is_the_raw_reading_less_the_payload_s_weight_whatever_the_controller_has_configured(
    offset: tuple[float, ...],
) -> None:
    """In any attitude, at the TCP of `[ur]`; neither the controller's zero nor its TCP or payload has a part in it."""
    flange = rotation_from_rotvec(np.array([2.0, 1.5, -0.4]))
    rotvec = rotvec_from_rotation(flange @ rotation_from_rotvec(np.array(offset[3:])))
    tcp, com, kg = np.array(UR["tcp_m"][:3]), np.array(UR["payload_com_m"]), UR["payload_kg"]
    pressed, weight = np.array([3.0, -4.0, 17.0]), flange.T @ [0.0, 0.0, -9.81 * kg]
    own = flange.T @ pressed
    raw = (*(own + weight), *(np.cross(tcp, own) + np.cross(com, weight)))
    sample = a_sample(ft_raw=raw, tcp_pose=(0.3, 0.0, 0.2, *rotvec), tcp_offset=offset, payload_kg=0.1)
    assert sample.unzeroed == pytest.approx([*pressed, 0.0, 0.0, 0.0], abs=1e-9)
    assert sample.wrench == pytest.approx(np.zeros(6)), "which the controller has zeroed"
    assert sample.ft_raw == pytest.approx(raw)
    assert sample.joint_force == pytest.approx([1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("raw", "saturated"),
    [
        ((29.9, 0, 0, 0, 0, 0), False),
        ((0, -30.0, 0, 0, 0, 0), True),
        ((0, 0, 0, 0, 0, 10.0), True),
        ((0, math.nan, 0, 0, 0, 0), True),
    ],
)
def test_a_raw_channel_at_the_end_of_its_range_saturates(raw, saturated: bool) -> None:
    assert a_sample(ft_raw=raw).saturated is saturated


def test_a_sample_says_what_the_program_says_while_it_runs() -> None:
    sample = a_sample(program=2, reason=2)
    assert (sample.program, sample.stop_reason) == (Program.STOPPING, StopReason.FORCE_CEILING)
    assert (sample.seq, sample.command_seq, sample.peak_force_n) == (30_000, 4, 3.0)


def test_registers_of_a_program_that_has_ended_are_not_believed() -> None:
    sample = a_sample(running=False, program=1, reason=0)
    assert (sample.program, sample.stop_reason) == (Program.IDLE, StopReason.PROGRAM_ENDED)


def test_a_protective_stop_is_seen_whatever_the_registers_say() -> None:
    assert a_sample(running=False, safety_mode=3).program is Program.PROTECTIVE_STOP


def test_a_register_with_a_state_that_there_is_not_is_no_sample() -> None:
    with pytest.raises(ValueError, match="17"):
        a_sample(program=17)


def test_a_controller_that_was_restarted_is_another_source_to_the_monitor() -> None:
    reader = SampleReader(ur_config().ur)
    monitor = Monitor(MonitorParameters(30.0, 5.0, 10, 25, 0.05, 0.05))
    verdicts = []
    for index, time_s in enumerate((60.0, 60.002, 40.0)):
        at = package(time_s=time_s, tcp_force=(0.1 * index, 0.0, 0.0, 0.0, 0.0, 0.0))
        sample = reader.read(at, time_s, running=True, episode=0, hole_estimate=None)
        verdicts.append(
            monitor.check(
                epoch=sample.epoch,
                episode=sample.episode,
                seq=sample.seq,
                time_s=sample.time_s,
                wrench=sample.wrench,
                raw=sample.ft_raw,
                motion=sample.q,
                saturated=False,
                now=sample.arrival_s,
            ).fault
        )
    assert verdicts == [None, None, FaultCode.SOURCE]


def test_a_program_runs_only_while_its_counter_moves() -> None:
    watch = ProgramWatch(CRC)
    assert not watch.observe(package(counter=10)), "a number alone may be of a program that has ended"
    assert watch.observe(package(time_s=60.002, counter=11))
    assert watch.observe(package(time_s=60.05, counter=11)), "zeroing the sensor may take some steps"
    assert not watch.observe(package(time_s=60.01 + ALIVE_S, counter=11))
    assert watch.observe(package(time_s=60.2, counter=12))


@pytest.mark.parametrize("fields", [{"runtime_state": 1}, {"runtime_state": 4}, {"crc": CRC + 1}])
def test_a_program_that_is_stopped_paused_or_another_does_not_run(fields) -> None:
    watch = ProgramWatch(CRC)
    watch.observe(package(counter=10))
    assert watch.observe(package(time_s=60.002, counter=11))
    assert not watch.observe(package(time_s=60.004, counter=12, **fields))


def test_packages_that_waited_in_the_socket_are_dated_back_to_their_arrival() -> None:
    clock = ArrivalClock()
    for tick in range(100):
        read_s = 5.0 + tick * 0.002 + (0.001 if tick % 3 else 0.0)
        assert clock.arrival(60.0 + tick * 0.002, read_s) == pytest.approx(5.0 + tick * 0.002, abs=5e-4)
    held_up_s = 5.2 + 0.3
    assert clock.arrival(60.2, held_up_s) == pytest.approx(5.2, abs=1e-3)
    assert clock.arrival(60.498, held_up_s) == pytest.approx(5.498, abs=1e-3)


def test_an_arrival_is_never_later_than_its_reading_and_follows_a_drifting_clock() -> None:
    clock = ArrivalClock()
    for tick in range(0, 50_000, 50):
        stamp_s = tick * 0.002
        read_s = 5.0 + stamp_s * (1.0 + 100e-6)
        arrival_s = clock.arrival(stamp_s, read_s)
        assert read_s - 2e-4 <= arrival_s <= read_s


def test_a_controller_whose_clock_stood_is_late_for_a_moment_only() -> None:
    clock = ArrivalClock()
    ages = [
        read_s - clock.arrival(tick * 0.002, read_s)
        for tick in range(2000)
        for read_s in [5.0 + tick * 0.002 + (0.1 if tick >= 1000 else 0.0)]
    ]
    assert ages[1000] == pytest.approx(0.1)
    assert max(ages[1000 + 600 :]) == pytest.approx(0.0, abs=1e-9)
