"""Requests to a simulated world over Zenoh: the query that a key names, and its JSON payload."""

import json
import re
from collections.abc import Collection, Mapping
from typing import Any, cast

import zenoh

from wire.task import Task

MAX_OBJECT_BYTES = 4096
"""Largest JSON object of a request, bytes."""


class RequestError(ValueError):
    """A request that cannot be carried out and changed nothing; the text is the reply to the client."""


def query_keys(world: str, queries: Mapping[str, str]) -> dict[str, zenoh.KeyExpr]:
    """Return the keys of a world's queries by name.

    Args:
        world: name of the world in its keys.
        queries: patterns of `wire.keys` by name.

    Raises:
        ValueError: a key cannot contain `world`.
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", world):
        raise ValueError(f"world {world!r}: use letters, digits, '-', '_' and '.', at most 64")
    return {name: zenoh.KeyExpr(key.format(world=world)) for name, key in queries.items()}


def asked(query: zenoh.Query, keys: Mapping[str, zenoh.KeyExpr], readings: Collection[str]) -> str:
    """Return the name of the query that a client asks. A wildcard may name a reading; what changes a world, it may not.

    Args:
        query: the client's.
        keys: the world's queries by name.
        readings: names of the queries that change nothing.

    Raises:
        RequestError: the query's key matches none of `keys` or several, or is not the own key of what it would change.
    """
    names = [name for name, key in keys.items() if query.key_expr.intersects(key)]
    if len(names) != 1:
        raise RequestError(f"{query.key_expr} names {len(names)} queries, ask one of {', '.join(keys)}")
    name = names[0]
    if name not in readings and str(query.key_expr) != str(keys[name]):
        raise RequestError(f"{name}: a wildcard reads, it changes nothing; ask {keys[name]}")
    return name


def read_parameters(text: str, form: str, *names: str) -> dict[str, str]:
    """Read the parameters of a request, `name=value` with a semicolon between them.

    Args:
        text: the parameters.
        form: what they must be, for the error.
        *names: the known ones.

    Raises:
        RequestError: a parameter is unknown, or stands twice.
    """
    parts = [part for part in text.split(";") if part]
    parameters = {name: value for name, _, value in (part.partition("=") for part in parts)}
    if len(parameters) != len(parts) or not parameters.keys() <= set(names):
        raise RequestError(f"parameters must be {form}, not {text[:80]!r}")
    return parameters


def read_object(payload: bytes, request: str) -> dict[str, Any]:
    """Read the JSON object of a request.

    Args:
        payload: payload of the request, at most `MAX_OBJECT_BYTES`.
        request: name of the request, for the error.

    Raises:
        RequestError: the payload is not a JSON object, or too long.
    """
    if len(payload) > MAX_OBJECT_BYTES:
        raise RequestError(f"{request}: a payload of {len(payload)} bytes, at most {MAX_OBJECT_BYTES}")
    try:
        document = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise RequestError(f"{request}: the payload is not JSON: {error}") from error
    if not isinstance(document, dict):
        raise RequestError(f"{request}: the payload must be a JSON object")
    return cast(dict[str, Any], document)


def read_task(payload: bytes) -> Task:
    """Read the task of a reset.

    Args:
        payload: JSON object of a `Task`, such as `{"seed": 0}`.

    Raises:
        RequestError: the payload is not such an object, or a field is unknown, missing or out of range; the text names
            it.
    """
    document = read_object(payload, "reset")
    try:
        return Task.from_json(document)
    except ValueError as error:
        raise RequestError(f"reset: {error}") from error
