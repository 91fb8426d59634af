"""Functions that a script calls and this project implements."""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeAlias


class _Required:
    def __repr__(self) -> str:
        return "REQUIRED"


REQUIRED: Final = _Required()
"""The default of a parameter that has none."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """Name of a builtin's parameter as scripts write it, and its default or `REQUIRED`."""

    name: str
    default: Any = REQUIRED


@dataclass(frozen=True, slots=True)
class Builtin:
    """One function of the controller.

    Attributes:
        call: Takes script values (see `values`) by position and returns one, or None. It raises `ScriptRuntimeError`.
        parameters: In the order of the call.
        blocking: `call` returns a generator: each `yield` waits for the next tick, what it returns is the result. It is
            closed when its thread is killed, so that a `finally` can give back what it holds.
    """

    call: Callable[..., Any]
    parameters: tuple[Parameter, ...]
    blocking: bool

    @classmethod
    def of(cls, function: Callable[..., Any]) -> "Builtin":
        """The builtin that `function` is; parameters and defaults are those of its signature, which is all plain names.

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
"""Builtins by the name that scripts call."""
