"""The rule for stops: which requests are stops, which of them are hostile, and who asked.

A stop is refused only if it is provably hostile: a browser sent it for a page of another site. Its address, `Host`,
version, body and the spelling of its path refuse no stop. Reading (`GET`, `HEAD`, `OPTIONS`, `TRACE`) stops nothing.
"""

import re
from collections.abc import Collection
from urllib.parse import parse_qs, urlsplit

from starlette.datastructures import Headers
from starlette.types import Scope

STOP_PATH = "/stop"
READING_METHODS = frozenset({"GET", "HEAD", "OPTIONS", "TRACE"})
OPERATOR_LENGTH = 64
AGENT_LENGTH = 24
OTHER_SITES = frozenset({"cross-site", "same-site"})
_FORWARDED_HOST = re.compile(r'host\s*=\s*"?([^",;\s]+)', re.IGNORECASE)


def is_stop(method: str, path: str) -> bool:
    """Return whether a request asks for a stop: it does more than read, and its path ends in `stop`.

    A slash at the end, a doubled slash, a prefix that a proxy left in place and the case of letters make no difference.

    Args:
        method: as sent.
        path: percent-decoded, without the query.
    """
    return method.upper() not in READING_METHODS and path.rstrip("/").rpartition("/")[2].lower() == "stop"


def why_hostile(headers: Headers, own_hosts: Collection[str]) -> str | None:
    """Say why a stop comes from a page of another site; None if that is not proven.

    The browser's own word, `Sec-Fetch-Site`, decides where it is given. Otherwise `Origin` must name this server: by
    `Host`, by a host that a proxy forwarded, or by a configured name. A page cannot set any of these headers for a
    request to another site. A client that is no browser sends none of them.

    Args:
        headers: of the request.
        own_hosts: configured names of this server, lower case, without ports.
    """
    site, origin = headers.get("sec-fetch-site", "").strip().lower(), headers.get("origin")
    if site:
        return f"the browser calls it {site}" if site in OTHER_SITES else None
    if origin is None or _hostname(origin) in own_hosts or any(_is_at(origin, host) for host in _hosts(headers)):
        return None
    return f"its origin is {origin}"


def asked_by(scope: Scope) -> str:
    """Name who asked: the `operator` of the query if there is one, the client's address, and its program.

    Nobody is authenticated. The name is what the client says of itself.
    """
    operator = _printable("".join(parse_qs(_text(scope["query_string"])).get("operator", [])), OPERATOR_LENGTH)
    client = scope.get("client")
    address = f"{client[0]}:{client[1]}" if client else "a local socket"
    agent = _printable(Headers(scope=scope).get("user-agent", "").partition(" ")[0], AGENT_LENGTH)
    return f"{operator or 'somebody'} at {address}{f' with {agent}' if agent else ''}"


def _hosts(headers: Headers) -> list[str]:
    forwarded = [host.strip() for host in headers.get("x-forwarded-host", "").split(",")]
    forwarded += _FORWARDED_HOST.findall(headers.get("forwarded", ""))
    return [host for host in (headers.get("host", ""), *forwarded) if host]


def _is_at(origin: str, host: str) -> bool:
    """Return whether an origin is at a host. A host without a port is at any: a proxy may leave the port out."""
    try:
        ours, theirs = urlsplit(f"//{host}"), urlsplit(origin)
        default = {"http": 80, "https": 443}.get(theirs.scheme)
        return bool(ours.hostname) and (
            ours.hostname == theirs.hostname and ours.port in {None, theirs.port or default}
        )
    except ValueError:
        return False


def _hostname(origin: str) -> str | None:
    try:
        return urlsplit(origin).hostname
    except ValueError:
        return None


def _text(query: bytes) -> str:
    return query.decode("latin-1")


def _printable(text: str, length: int) -> str:
    return "".join(letter for letter in text if letter.isprintable())[:length].strip()
