"""Kinds of fields that several sections share, and the base of every section.

Every number has a lower and an upper bound: the value beyond which the field no longer guards, or no longer works. The
bound's reason is its description, which `dsl-assembly config schema` prints.
"""

import math
import re
from ipaddress import ip_address
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from service.messages import NAME_PATTERN
from wire.limits import FORCE_HARD_MAXIMUM_N, TORQUE_HARD_MAXIMUM_NM


def number(low: float, high: float, why: str) -> Any:
    """Return the bounds of a finite number, both included.

    Args:
        low: smallest value.
        high: largest value.
        why: reason for the lower bound; reason for the upper bound.
    """
    return Field(ge=low, le=high, allow_inf_nan=False, description=why)


def count(low: int, high: int, why: str) -> Any:
    """Return the bounds of an integer, as `number` does."""
    return Field(ge=low, le=high, description=why)


def _check_box(box: tuple[tuple[float, float, float], tuple[float, float, float]]) -> Any:
    lower, upper = box
    if any(low >= high for low, high in zip(lower, upper, strict=True)):
        raise ValueError("the lower corner must lie below the upper corner on every axis")
    return box


def _check_host(host: str) -> str:
    if re.fullmatch(r"[A-Za-z0-9._-]+", host) is None:
        try:
            ip_address(host)
        except ValueError:
            text = f"must be a name or an address alone, without http://, port and path, not {host!r}"
            raise ValueError(text) from None
    return host


Force = Annotated[float, number(1.0, FORCE_HARD_MAXIMUM_N, "below it noise alone trips; the hard maximum")]
Torque = Annotated[float, number(0.1, TORQUE_HARD_MAXIMUM_NM, "below it noise alone trips; the hard maximum")]
Coordinate = Annotated[float, number(-2.0, 2.0, "no arm of the series reaches 2 m")]
Offset = Annotated[float, number(-0.5, 0.5, "a tool is shorter than 0.5 m")]
Turn = Annotated[float, number(-2.0 * math.pi, 2.0 * math.pi, "one full turn either way")]
Position = tuple[Coordinate, Coordinate, Coordinate]
Box = Annotated[tuple[Position, Position], AfterValidator(_check_box)]
Name = Annotated[str, Field(pattern=NAME_PATTERN)]
Host = Annotated[str, AfterValidator(_check_host)]
Port = Annotated[int, count(1, 65535, "ports of TCP")]
CommonName = Annotated[str, Field(min_length=1, max_length=64)]
Endpoint = Annotated[str, Field(pattern=r"^(tcp|tls|quic|unixsock-stream)/\S+$")]


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
