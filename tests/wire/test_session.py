"""Endpoints of a simulated cell: loopback unless allowed, and a clear word for what cannot be."""

import socket
import time

import pytest

from wire.endpoints import EndpointError, check_endpoint
from wire.session import open_session


@pytest.mark.parametrize(
    "endpoint",
    [
        "tcp/127.0.0.1:7447",
        "tcp/localhost:7447",
        "tcp/[::1]:7447",
        "udp/127.8.0.1:1",
        "tcp/127.0.0.1:0",
        "unixsock-stream//run/a",
    ],
)
def test_loopback_is_accepted(endpoint: str) -> None:
    check_endpoint(endpoint, allow_remote=False)


@pytest.mark.parametrize(
    "endpoint", ["tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/192.168.1.5:7447", "tcp/127.0.0.1.example.com:7447"]
)
def test_anything_else_needs_permission(endpoint: str) -> None:
    with pytest.raises(EndpointError, match="--allow-remote"):
        check_endpoint(endpoint, allow_remote=False)
    check_endpoint(endpoint, allow_remote=True)


@pytest.mark.parametrize("endpoint", ["", "7447", "tcp/127.0.0.1", "tcp/127.0.0.1:65536", "ipx/127.0.0.1:1", "tcp/a b"])
def test_a_malformed_endpoint_is_named(endpoint: str) -> None:
    with pytest.raises(EndpointError, match="not of the form"):
        check_endpoint(endpoint, allow_remote=True)


def test_a_taken_port_is_one_clear_line() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        endpoint = f"tcp/127.0.0.1:{other.getsockname()[1]}"
        with pytest.raises(EndpointError, match=f"{endpoint} is in use") as raised:
            open_session([endpoint])
    assert "\n" not in str(raised.value)


def test_a_session_is_open_until_left(free_endpoint: str) -> None:
    with open_session([free_endpoint]) as session:
        assert not session.is_closed()
    assert session.is_closed()


def test_sessions_that_were_told_of_no_other_find_none() -> None:
    with open_session() as first, open_session() as second:
        time.sleep(1.0)  # multicast scouting finds a peer within a tenth of this
        assert list(first.info.peers_zid()) == list(second.info.peers_zid()) == []
