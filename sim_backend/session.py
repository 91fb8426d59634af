"""Opening the Zenoh session of a simulated cell: explicit endpoints, loopback unless allowed, nothing scouted."""

import ipaddress
import json
import re
from collections.abc import Sequence

import zenoh

DEFAULT_WORLD = "world-1"
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7448"
"""World and endpoint of `config/cell.toml`."""

_ENDPOINT = re.compile(r"(?P<protocol>tcp|udp|tls|quic|ws)/(?P<host>\[[^\]]+\]|[^:/\[\]]+):(?P<port>\d{1,5})([?#].*)?")


class EndpointError(ValueError):
    """An endpoint that is refused, malformed or taken; the text names it and says what to do."""


def check_endpoint(endpoint: str, *, allow_remote: bool) -> None:
    """Refuse an endpoint that Zenoh could not read, or that leaves this machine unasked.

    Args:
        endpoint: `protocol/host:port`, for instance `tcp/127.0.0.1:7447`.
        allow_remote: whether a host other than loopback is wanted.

    Raises:
        EndpointError: malformed, or not loopback while `allow_remote` is false.
    """
    match = _ENDPOINT.fullmatch(endpoint)
    if match is None or int(match["port"]) > 65535:
        raise EndpointError(f"endpoint {endpoint!r} is not of the form tcp/127.0.0.1:7447")
    check_host(match["host"].strip("[]"), allow_remote=allow_remote)


def check_host(host: str, *, allow_remote: bool) -> None:
    """Refuse an address that leaves this machine unasked.

    Raises:
        EndpointError: not loopback while `allow_remote` is false.
    """
    if not allow_remote and not _is_loopback(host):
        raise EndpointError(
            f"{host} is not on loopback: whoever reaches it can move the arm. "
            "Add --allow-remote if the network is trusted"
        )


def open_session(listen: Sequence[str], connect: Sequence[str] = (), *, allow_remote: bool = False) -> zenoh.Session:
    """Open a session in peer mode that listens and connects where it is told, and nowhere else.

    Args:
        listen: endpoints to accept peers at.
        connect: endpoints of peers or routers to join; tried again until they are there.
        allow_remote: whether endpoints may leave this machine.

    Returns:
        An open session; the caller closes it.

    Raises:
        EndpointError: an endpoint is refused or malformed, or its port is taken.
    """
    for endpoint in (*listen, *connect):
        check_endpoint(endpoint, allow_remote=allow_remote)
    config = zenoh.Config()
    for key, value in {
        "mode": "peer",
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "connect/exit_on_failure": False,
        "connect/timeout_ms": -1,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,  # a killed process would leave segments behind
    }.items():
        config.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        where = ", ".join(listen)
        if "Address already in use" in str(error):
            raise EndpointError(f"{where} is in use by another process: choose another --listen") from error
        raise EndpointError(f"cannot listen at {where}: {str(error).split(' at /', 1)[0]}") from error


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
