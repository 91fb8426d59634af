"""Settings and fixtures of all tests."""

import os
import socket
from pathlib import Path

import pytest
import structlog
from hypothesis import settings

from service.logs import PROCESSORS

# How long an example takes says something about the machine, and nothing about the code.
settings.register_profile("without_deadline", deadline=None)
settings.load_profile("without_deadline")

# On a busy test machine processes of ordinary priority are late; few tests are about that.
REALTIME_VARIABLE = "DSL_ASSEMBLY__CELL__REALTIME"
os.environ[REALTIME_VARIABLE] = "true"

REAL_TIME = (
    "api",
    "benchmarks",
    "cli",
    "examples",
    "fuzz",
    "strangers",
    "docs/test_examples.py",
    "sim_backend/test_metronome.py",
    "sim_backend/ur_controller/test_process.py",
    "sim_backend/zenoh_cell",
    "service/cell/test_control_plane.py",
    "service/cell/test_deaf_client.py",
    "service/cell/test_forged_commands.py",
    "service/cell/test_kills.py",
    "service/cell/test_overload.py",
    "service/cell/test_policy_process.py",
    "service/cell/test_process.py",
    "service/cell/test_secured_cell.py",
    "service/cell/test_shared_arm.py",
    "service/cell/test_watchdog.py",
    "service/drivers/test_camera.py",
    "service/drivers/test_zenoh_sim.py",
    "service/drivers/ur/test_attack_driver.py",
    "service/drivers/ur/test_cut_links.py",
    "service/drivers/ur/test_driver.py",
    "service/drivers/ur/test_link_faults.py",
    "service/drivers/ur/test_process.py",
    "service/test_logs.py",
    "service/test_program.py",
    "simulation/test_seeds.py",
    "test_end_to_end.py",
    "test_packaging.py",
    "training/evaluation/test_through_service.py",
)
"""Tests that start processes or live by the host's clock, or use every core: they run one after another."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that must not run beside others."""
    root = Path(__file__).parent
    real_time = tuple(root / name for name in REAL_TIME)
    for item in items:
        if any(item.path.is_relative_to(path) for path in real_time):
            item.add_marker(pytest.mark.realtime)


@pytest.fixture(autouse=True)
def logs_of_a_test() -> None:
    """Log to the standard output of this test; an earlier one may have sent the log to a stream that is closed now."""
    structlog.reset_defaults()
    structlog.configure(processors=PROCESSORS)


@pytest.fixture
def free_endpoint() -> str:
    """A loopback endpoint whose port was free a moment ago."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"
