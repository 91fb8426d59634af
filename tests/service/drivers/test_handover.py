import threading

import numpy as np

from service.drivers.base import Program, Sample, StopReason
from service.drivers.handover import Handover
from service.faults import FaultCode


def sample(seq: int, force: float = 0.0, saturated: bool = False) -> Sample:
    zero3, zero6 = np.zeros(3), np.zeros(6)
    wrench = np.array([0.0, 0.0, force, 0.0, 0.0, 0.0])
    return Sample(
        epoch=1, episode=0, seq=seq, time_s=seq * 0.002, arrival_s=seq * 0.002, q=zero6, qd=zero6,
        tcp_position=zero3, tcp_rotvec=zero3, tcp_velocity=zero6, wrench=wrench, unzeroed=wrench,
        ft_raw=wrench, joint_force=None, saturated=saturated, hole_estimate=None,
        program=Program.IDLE, stop_reason=StopReason.NONE, robot_mode=7, safety_mode=1, command_seq=0, peak_force_n=0.0,
    )  # fmt: skip


def seqs(handover: Handover) -> list[int]:
    return [taken.seq for taken in handover.take()[0]]


def test_samples_come_out_in_the_order_in_which_they_went_in() -> None:
    handover = Handover(8)
    for seq in range(5):
        handover.offer(sample(seq))
    assert seqs(handover) == [0, 1, 2, 3, 4]
    assert seqs(handover) == []


def test_the_reader_is_woken_once_per_batch() -> None:
    handover = Handover(8)
    assert [handover.offer(sample(seq)) for seq in range(3)] == [True, False, False]
    handover.take()
    assert handover.offer(sample(3))


def test_23_an_overload_keeps_the_newest_and_counts_what_it_drops() -> None:
    handover = Handover(4)
    for seq in range(10):
        handover.offer(sample(seq))
    assert seqs(handover)[-4:] == [6, 7, 8, 9]
    assert handover.dropped == 6


def test_23_a_force_peak_that_is_dropped_is_handed_over_all_the_same_and_first() -> None:
    handover = Handover(4)
    for seq in range(20):
        handover.offer(sample(seq, force=-80.0 if seq == 3 else 1.0))
    taken, _ = handover.take()
    assert [one.seq for one in taken][-4:] == [16, 17, 18, 19]
    assert -80.0 in [one.wrench[2] for one in taken[:-4]]


def test_23_a_torque_peak_is_not_hidden_by_a_force_that_is_no_peak() -> None:
    handover = Handover(4)
    for seq in range(20):
        one = sample(seq, force=9.0 if seq == 7 else 1.0)
        one.wrench[4] = 6.0 if seq == 3 else 0.01
        handover.offer(one)
    assert seqs(handover) == [3, 7, 16, 17, 18, 19]


def test_23_of_dropped_samples_one_that_is_no_number_or_saturated_counts_as_the_largest() -> None:
    for bad in (sample(1, force=np.nan), sample(1, saturated=True)):
        handover = Handover(2)
        for one in (sample(0, force=500.0), bad, *(sample(seq) for seq in range(2, 8))):
            handover.offer(one)
        assert [one.seq for one in handover.take()[0]] == [1, 6, 7]


def test_a_fault_of_the_link_comes_out_once_the_first_of_several() -> None:
    handover = Handover(4)
    assert handover.report(FaultCode.PROTOCOL, "first")
    assert not handover.report(FaultCode.LINK, "second")
    assert handover.take()[1] == (FaultCode.PROTOCOL, "first")
    assert handover.take()[1] is None


def test_nothing_is_lost_between_a_writer_and_a_reader_that_keeps_up() -> None:
    handover, found = Handover(100_000), []
    writer = threading.Thread(target=lambda: [handover.offer(sample(seq)) for seq in range(3000)])
    writer.start()
    while writer.is_alive():
        found += seqs(handover)
    found += seqs(handover)
    assert found == list(range(3000))
