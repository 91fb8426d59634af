"""Zenoh endpoints: the default one, whether somebody listens at one, and the rule that a server stays on this machine
unless allowed otherwise.
"""

import contextlib
import ipaddress
import re
import socket

DEFAULT_WORLD = "world-1"
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7448"
"""Endpoint of the simulated cell in `config/cell.toml`; `DEFAULT_WORLD` is its world."""

_LOCAL = "unixsock-stream/"
"""Beginning of the endpoints that are sockets in the file system of this machine."""
_STREAMS = ("tcp", "tls", "ws")
"""Protocols under which a connection shows whether somebody listens."""
CONNECT_S = 1.0
"""Time that a listener has to take a connection, s."""
_ENDPOINT = re.compile(r"(?P<protocol>tcp|udp|tls|quic|ws)/(?P<host>\[[^\]]+\]|[^:/\[\]]+):(?P<port>\d{1,5})([?#].*)?")


class EndpointError(OSError, ValueError):
    """An endpoint is refused, malformed or taken; the text names it and says what to do."""


class EndpointInUseError(EndpointError):
    """Another process listens at the endpoint; the text names it."""


def check_endpoint(endpoint: str, *, allow_remote: bool) -> None:
    """Refuse an endpoint that Zenoh cannot read, or that leaves this machine without permission.

    Args:
        endpoint: `protocol/host:port`, for instance `tcp/127.0.0.1:7447`.
        allow_remote: allow hosts other than loopback.

    Raises:
        EndpointError: malformed, or not loopback while `allow_remote` is false.
    """
    if endpoint.startswith(_LOCAL):
        return
    check_host(_host(endpoint), allow_remote=allow_remote)


def is_local(endpoint: str) -> bool:
    """Return whether an endpoint can be reached from this machine alone. A malformed one cannot be told to be."""
    try:
        return endpoint.startswith(_LOCAL) or _is_loopback(_host(endpoint))
    except EndpointError:
        return False


def has_listener(endpoint: str) -> bool | None:
    """Return whether something listens at an endpoint; None where a connection cannot tell.

    Blocks for at most `CONNECT_S`.
    """
    match = _ENDPOINT.fullmatch(endpoint)
    with contextlib.suppress(OSError, OverflowError):  # a port beyond 65535 overflows
        if endpoint.startswith(_LOCAL):
            with socket.socket(socket.AF_UNIX) as local:
                local.settimeout(CONNECT_S)
                local.connect(endpoint.removeprefix(_LOCAL))
        elif match is None or match["protocol"] not in _STREAMS:
            return None
        else:
            socket.create_connection((match["host"].strip("[]"), int(match["port"])), timeout=CONNECT_S).close()
        return True
    return False


def check_host(host: str, *, allow_remote: bool) -> None:
    """Refuse an address that leaves this machine without permission.

    Raises:
        EndpointError: not loopback while `allow_remote` is false.
    """
    if not allow_remote and not _is_loopback(host):
        raise EndpointError(
            f"{host} is not on loopback: whoever reaches it can move the arm. "
            "Add --allow-remote if the network is trusted"
        )


def _host(endpoint: str) -> str:
    match = _ENDPOINT.fullmatch(endpoint)
    if match is None or int(match["port"]) > 65535:
        raise EndpointError(f"endpoint {endpoint!r} is not of the form tcp/127.0.0.1:7447")
    return match["host"].strip("[]")


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
