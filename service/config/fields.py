"""Kinds of fields that several sections share, and the base of every section."""

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from service.messages import NAME_PATTERN
from wire.limits import FORCE_HARD_MAXIMUM_N, TORQUE_HARD_MAXIMUM_NM


def _check_box(box: tuple[tuple[float, float, float], tuple[float, float, float]]) -> Any:
    lower, upper = box
    if any(low >= high for low, high in zip(lower, upper, strict=True)):
        raise ValueError("the lower corner must lie below the upper corner on every axis")
    return box


Force = Annotated[float, Field(gt=0.0, le=FORCE_HARD_MAXIMUM_N, allow_inf_nan=False)]
Torque = Annotated[float, Field(gt=0.0, le=TORQUE_HARD_MAXIMUM_NM, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Position = tuple[Finite, Finite, Finite]
Box = Annotated[tuple[Position, Position], AfterValidator(_check_box)]
SixPositive = tuple[Positive, Positive, Positive, Positive, Positive, Positive]
Name = Annotated[str, Field(pattern=NAME_PATTERN)]
Port = Annotated[int, Field(ge=1, le=65535)]
Endpoint = Annotated[str, Field(pattern=r"^(tcp|tls|quic|unixsock-stream)/\S+$")]


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
