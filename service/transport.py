"""Zenoh sessions of this project: explicit endpoints, no discovery, no listening that was not asked for."""

import json
from collections.abc import Sequence

import zenoh


def open_session(*, listen: Sequence[str] = (), connect: Sequence[str] = ()) -> zenoh.Session:
    """Open a session on exactly these endpoints; the caller closes it.

    A connection that cannot be made now is retried in the background, so a peer may start later.

    Args:
        listen: endpoints such as `tcp/127.0.0.1:7447`.
        connect: endpoints of peers.

    Raises:
        OSError: an endpoint cannot be listened on; the text names it.
    """
    config = zenoh.Config()
    settings: dict[str, object] = {
        "mode": "peer",
        "listen/endpoints": list(listen),
        "listen/exit_on_failure": True,
        "connect/endpoints": list(connect),
        "connect/exit_on_failure": False,
        "connect/timeout_ms": -1,
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2.0},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/queue/batching/enabled": False,
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))  # pyright: ignore[reportUnknownMemberType]  # untyped in zenoh
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise OSError(
            f"cannot open a Zenoh session listening on {', '.join(listen) or 'nothing'}: {error}; "
            "is another process using the port?"
        ) from error


def close_session(session: zenoh.Session) -> None:
    """Close a session; an unclosed one can hang the interpreter's exit. Blocks for some milliseconds."""
    session.close()  # pyright: ignore[reportUnknownMemberType]  # untyped in zenoh
