"""Settings and fixtures of all tests."""

import socket

import pytest
import structlog
from hypothesis import settings

from service.logs import PROCESSORS

# How long an example takes says something about the machine, and nothing about the code.
settings.register_profile("without_deadline", deadline=None)
settings.load_profile("without_deadline")


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
