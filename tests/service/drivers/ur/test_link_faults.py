"""A connection that is cut, stalled or spoilt under an arm that moves."""

import random
from collections.abc import AsyncIterator, Callable

import numpy as np
import pytest

from service.drivers.base import Program, StopReason
from service.faults import FaultCode
from tests.fault_proxy import FaultProxy, chunked
from tests.service.drivers.ur.emulated import Emulated, emulated
from tests.service.drivers.ur.test_driver import engaged, step
from wire.rtde.modes import RuntimeState


@pytest.fixture
async def moving() -> AsyncIterator[Emulated]:
    """An arm that goes down towards the block, behind a proxy."""
    async with emulated(proxied=True) as arm:
        await engaged(arm)
        for _ in range(10):
            step(arm, -0.005)
            await arm.pass_time(0.02)
        assert np.abs(arm.plant.qd).max() > 0.02
        yield arm


async def cut(proxy: FaultProxy) -> None:
    await proxy.reset()


async def garble(proxy: FaultProxy) -> None:
    proxy.to_client.spoil = lambda chunk: [bytes(3) + chunk]  # no package is shorter than its own header


@pytest.mark.parametrize("spoil", [cut, garble])
async def test_16_a_link_that_is_reset_or_carries_nonsense_is_one_fault_and_the_program_ends(
    moving: Emulated, spoil: Callable
) -> None:
    await spoil(moving.proxy)
    await moving.until(lambda: bool(moving.faults), 2.0)
    await moving.pass_time(0.5)
    assert len(moving.faults) == 1
    assert moving.faults[0][0] in (FaultCode.LINK, FaultCode.PROTOCOL)
    assert moving.controller.runtime_state is RuntimeState.STOPPED, "the watchdog has ended the program"
    assert np.abs(moving.plant.qd).max() < 1e-3


async def test_orders_that_do_not_get_through_end_the_program_and_the_host_sees_it(moving: Emulated) -> None:
    moving.proxy.to_service.stall()
    await moving.until(lambda: moving.samples[-1].program is Program.IDLE, 0.5)
    assert moving.samples[-1].stop_reason is StopReason.PROGRAM_ENDED
    await moving.pass_time(0.2)
    assert np.abs(moving.plant.qd).max() < 1e-3
    moving.proxy.to_service.resume()
    await moving.pass_time(0.2)
    assert moving.controller.runtime_state is RuntimeState.STOPPED, "what was held back starts nothing"


async def test_packages_that_come_in_pieces_lose_nothing(moving: Emulated) -> None:
    moving.proxy.to_client.spoil = chunked(random.Random(0), 40)
    number = step(moving, -0.005)
    moving.samples.clear()
    await moving.pass_time(0.1)
    assert np.all(np.diff([sample.seq for sample in moving.samples]) == 1)
    assert moving.samples[-1].command_seq == number
    assert moving.faults == []


async def test_after_a_cut_the_driver_connects_again_and_the_program_runs_anew(moving: Emulated) -> None:
    await moving.proxy.reset()
    await moving.until(lambda: bool(moving.faults), 2.0)
    await moving.pass_time(0.3)
    await moving.driver.connect(moving)
    moving.samples.clear()
    await moving.until(lambda: len(moving.samples) > 5)
    assert moving.samples[-1].program is Program.IDLE
    assert moving.controller.runtime_state is RuntimeState.PLAYING
