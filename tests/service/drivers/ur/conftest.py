"""Tests of clients that promise to work on uvloop run on both event loops."""

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping

import pytest
import uvloop

from tests.fault_proxy import FaultProxy
from tests.service.drivers.ur.rtde_listener import Listener
from tests.service.drivers.ur.rtde_responder import RtdeResponder

ON_BOTH_LOOPS = {"test_rtde.py", "test_rtde_faults.py", "test_dashboard.py", "test_script_upload.py", "test_gripper.py"}


def pytest_asyncio_loop_factories(
    config: pytest.Config, item: pytest.Item
) -> Mapping[str, Callable[[], asyncio.AbstractEventLoop]]:
    loops = {"asyncio": asyncio.new_event_loop}
    return loops | {"uvloop": uvloop.new_event_loop} if item.path.name in ON_BOTH_LOOPS else loops


@pytest.fixture
async def robot() -> AsyncIterator[RtdeResponder]:
    async with RtdeResponder() as responder:
        yield responder


@pytest.fixture
async def proxy(robot: RtdeResponder) -> AsyncIterator[FaultProxy]:
    async with FaultProxy((robot.host, robot.port), robot.host) as between:
        yield between


@pytest.fixture
def listener() -> Listener:
    return Listener()
