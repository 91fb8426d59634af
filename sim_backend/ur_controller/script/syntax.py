"""Syntax tree of a script: text and place, without meaning."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

Place: TypeAlias = tuple[int, int]
"""Line and column, from 1."""


@dataclass(frozen=True, slots=True)
class Constant:
    """A number, string or boolean."""

    place: Place
    value: float | str


@dataclass(frozen=True, slots=True)
class Name:
    """A variable."""

    place: Place
    name: str


@dataclass(frozen=True, slots=True)
class ListLiteral:
    """`[...]`, or `p[...]` if `pose`."""

    place: Place
    items: tuple["Expression", ...]
    pose: bool = False


@dataclass(frozen=True, slots=True)
class Index:
    """`base[a]` or, of a matrix, `base[a, b]`."""

    place: Place
    base: "Expression"
    items: tuple["Expression", ...]


@dataclass(frozen=True, slots=True)
class Field:
    """`base.name`."""

    place: Place
    base: "Expression"
    name: str


@dataclass(frozen=True, slots=True)
class Argument:
    """One argument; `name` is empty for an argument by position."""

    place: Place
    name: str
    value: "Expression"


@dataclass(frozen=True, slots=True)
class Call:
    """`name(...)`; with `base` a method of that value, with `thread` a `run`."""

    place: Place
    name: str
    arguments: tuple[Argument, ...]
    base: "Expression | None" = None
    thread: bool = False


@dataclass(frozen=True, slots=True)
class Unary:
    """`-`, `+` or `not`."""

    place: Place
    operator: str
    operand: "Expression"


@dataclass(frozen=True, slots=True)
class Binary:
    """An operator between two operands."""

    place: Place
    operator: str
    left: "Expression"
    right: "Expression"


Expression: TypeAlias = Constant | Name | ListLiteral | Index | Field | Call | Unary | Binary


@dataclass(frozen=True, slots=True)
class Assign:
    """`target = value`; `scope` is the qualifier, if any."""

    place: Place
    target: Name | Index | Field
    value: Expression
    scope: Literal["", "global", "local"] = ""


@dataclass(frozen=True, slots=True)
class CallStatement:
    """A call whose result is dropped."""

    place: Place
    call: Call


@dataclass(frozen=True, slots=True)
class If:
    """Conditions and blocks of `if` and each `elif`, and the block of `else`."""

    place: Place
    branches: tuple[tuple[Expression, "Block"], ...]
    otherwise: "Block"


@dataclass(frozen=True, slots=True)
class While:
    """`while condition: block end`."""

    place: Place
    condition: Expression
    body: "Block"


@dataclass(frozen=True, slots=True)
class Return:
    """`return`, with or without a value."""

    place: Place
    value: Expression | None


@dataclass(frozen=True, slots=True)
class Simple:
    """A keyword alone: break, continue, halt, enter_critical or exit_critical."""

    place: Place
    keyword: str


@dataclass(frozen=True, slots=True)
class OnThread:
    """`join` or `kill` of a thread handle."""

    place: Place
    keyword: str
    handle: Expression


@dataclass(frozen=True, slots=True)
class Parameter:
    """A function's parameter and its default, if any."""

    place: Place
    name: str
    default: Expression | None


@dataclass(frozen=True, slots=True)
class Function:
    """`def`, `thread` or `sec`."""

    place: Place
    keyword: str
    name: str
    parameters: tuple[Parameter, ...]
    body: "Block"


Statement: TypeAlias = Assign | CallStatement | If | While | Return | Simple | OnThread | Function
Block: TypeAlias = tuple[Statement, ...]
