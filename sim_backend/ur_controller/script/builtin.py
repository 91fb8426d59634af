"""Functions that scripts call and this project implements."""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeAlias


class _Required:
    def __repr__(self) -> str:
        return "REQUIRED"


REQUIRED: Final = _Required()
"""Default that marks a parameter without a default."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """A builtin's parameter: its name in scripts, and its default or `REQUIRED`."""

    name: str
    default: Any = REQUIRED


@dataclass(frozen=True, slots=True)
class Builtin:
    """One function of the controller.

    Attributes:
        call: takes script values (see `values`) by position and returns one, or None. It raises `ScriptRuntimeError`.
        parameters: parameters in the order of the call.
        blocking: `call` returns a generator: each `yield` waits for the next tick, the return value is the result. The
            generator is closed when its thread is killed, so a `finally` can release its resources.
    """

    call: Callable[..., Any]
    parameters: tuple[Parameter, ...]
    blocking: bool

    @classmethod
    def of(cls, function: Callable[..., Any]) -> "Builtin":
        """Make a builtin from `function`, with the parameters and defaults of its signature, which has plain names
        only.

        A name that Python reserves is written with a trailing underscore, which scripts leave out.
        """
        signature = inspect.signature(function)
        for parameter in signature.parameters.values():
            if parameter.kind is not inspect.Parameter.POSITIONAL_OR_KEYWORD:
                raise TypeError(f"{function}: a builtin has plain parameters only, not {parameter}")
        return cls(
            call=function,
            parameters=tuple(
                Parameter(name.rstrip("_"), REQUIRED if p.default is inspect.Parameter.empty else p.default)
                for name, p in signature.parameters.items()
            ),
            blocking=inspect.isgeneratorfunction(function),
        )


Table: TypeAlias = Mapping[str, Builtin]
"""Builtins by script name."""
