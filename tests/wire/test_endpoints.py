"""An endpoint tells whether a process listens behind it."""

import socket
from pathlib import Path

import pytest

from wire.endpoints import has_listener


@pytest.mark.parametrize("protocol", ["tcp", "tls"])
def test_a_listener_is_told_by_a_connection(protocol: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        endpoint = f"{protocol}/127.0.0.1:{server.getsockname()[1]}"
        assert has_listener(endpoint) is True
    assert has_listener(endpoint) is False


def test_a_listener_at_a_socket_in_the_file_system_is_told_too(tmp_path: Path) -> None:
    endpoint = f"unixsock-stream/{tmp_path}/s"
    assert has_listener(endpoint) is False
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(f"{tmp_path}/s")
        server.listen()
        assert has_listener(endpoint) is True
    assert has_listener(endpoint) is False, "what a killed process leaves behind listens no more"
    assert has_listener(f"unixsock-stream/{'x' * 200}") is False


@pytest.mark.parametrize("endpoint", ["quic/127.0.0.1:7447", "udp/127.0.0.1:7447", "x"])
def test_of_an_endpoint_without_a_stream_nothing_can_be_told(endpoint: str) -> None:
    assert has_listener(endpoint) is None


def test_nobody_listens_at_a_port_that_there_is_not() -> None:
    assert has_listener("tcp/127.0.0.1:70000") is False
