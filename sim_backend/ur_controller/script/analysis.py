"""Scopes, calls and costs of a script, determined before code generation.

From UR's script manual, "Scoping rules": a variable of the program's first level is global with or without a qualifier,
and so is every variable that a `global` names. `local` variables and parameters belong to their function. A name
without a qualifier is the global one if there is one, else local. A function does not see the locals of the function
around it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

from .builtin import Builtin, Table
from .errors import CompileError
from .syntax import (
    Assign,
    Binary,
    Block,
    Call,
    CallStatement,
    Constant,
    Expression,
    Field,
    Function,
    If,
    Index,
    ListLiteral,
    Name,
    OnThread,
    Place,
    Return,
    Simple,
    Unary,
    While,
)

DEEPEST_EXPRESSION: Final = 120
DEEPEST_BLOCK: Final = 30
DEEPEST_LOOP: Final = 15
MOST_BRANCHES: Final = 300
BUILTIN_COST: Final = 30
"""Operations charged for a call of a builtin; one that works on long values charges more itself."""
COSTLIEST_PLAIN: Final = 500
"""Largest cost, in operations, of a function that runs to its end without checking the budget."""


@dataclass(eq=False, slots=True)
class Routine:
    """A function, thread or program.

    Attributes:
        functions: functions declared in it.
        optional: parameters with a default.
        own: names that are local regardless of globals: parameters and variables declared `local`.
        cost: operations of one call outside of loops; includes callees that are no generators after `resolve`.
        waits: it can wait for the next tick and becomes a generator.
        deep: it can call itself, directly or through others.
    """

    name: str
    keyword: str
    number: int
    parent: "Routine | None"
    functions: dict[str, "Routine"] = field(default_factory=dict["str", "Routine"])
    parameters: tuple[str, ...] = ()
    optional: frozenset[str] = frozenset()
    own: set[str] = field(default_factory=set[str])
    assigned: set[str] = field(default_factory=set[str])
    calls: list[Call] = field(default_factory=list[Call])
    cost: int = 1
    waits: bool = False
    deep: bool = False

    def find(self, name: str) -> "Routine | None":
        """Return the function that a call of `name` from here reaches, or None."""
        scope: Routine | None = self
        while scope is not None:
            if name in scope.functions:
                return scope.functions[name]
            scope = scope.parent
        return None


class Analysis:
    """All functions of a script by their syntax nodes, and its global names.

    Raises:
        CompileError: the nesting is too deep, or a statement is not allowed in its place.
    """

    def __init__(self, builtins: Table) -> None:
        self._builtins: Mapping[str, Builtin] = builtins
        self.routines: dict[int, Routine] = {}
        self.globals: set[str] = set()

    def declare(self, node: Function | Block, parent: Routine | None = None, depth: int = 0) -> Routine:
        """Enter a function, or the statements of a program without a name, with everything inside."""
        if isinstance(node, Function):
            routine = Routine(node.name, node.keyword, len(self.routines), parent)
            routine.parameters = tuple(p.name for p in node.parameters)
            routine.optional = frozenset(p.name for p in node.parameters if p.default is not None)
            routine.own.update(routine.parameters)
            if len(routine.own) != len(routine.parameters):
                raise CompileError(*node.place, f"Two parameters of {node.name} have one name")
            routine.waits = node.keyword != "def"
            if routine.waits and node.parameters:
                raise CompileError(*node.place, f"{node.name} is a {node.keyword}: it cannot have parameters")
            for parameter in node.parameters:
                if parameter.default is not None:
                    self._expression(routine, parameter.default, 1)
        else:
            routine = Routine("unnamed", "def", len(self.routines), parent)
        self.routines[id(node)] = routine
        self._block(routine, node.body if isinstance(node, Function) else node, depth + 1, 0)
        return routine

    def resolve(self, main: Routine) -> None:
        """Determine the globals and the generators after everything has been declared."""
        self.globals |= main.assigned | main.own - set(main.parameters)
        main.own.clear()
        main.waits = True
        routines = list(self.routines.values())
        callers: dict[int, list[Routine]] = {r.number: [] for r in routines}
        open_calls = {r.number: 0 for r in routines}
        for routine in routines:
            for call in routine.calls:
                callee = routine.find(call.name)
                if callee is not None:
                    callers[callee.number].append(routine)
                    open_calls[routine.number] += 1
                elif call.name in self._builtins:
                    routine.waits |= self._builtins[call.name].blocking
                    routine.cost += BUILTIN_COST
        settled = [r for r in routines if not open_calls[r.number]]
        for routine in settled:  # grows: callees come first
            routine.waits |= routine.cost > COSTLIEST_PLAIN
            for caller in callers[routine.number]:
                caller.waits |= routine.waits
                caller.cost += 0 if routine.waits else routine.cost
                open_calls[caller.number] -= 1
                if not open_calls[caller.number]:
                    settled.append(caller)
        for routine in routines:
            if open_calls[routine.number]:
                routine.waits = routine.deep = True

    def is_local(self, routine: Routine, name: str) -> bool:
        """Return True if `name` is a local variable of `routine`."""
        return name in routine.own or (name in routine.assigned and name not in self.globals)

    def _block(self, routine: Routine, block: Block, depth: int, loops: int) -> None:
        for node in block:
            if depth > DEEPEST_BLOCK:
                raise CompileError(*node.place, f"Blocks can be nested {DEEPEST_BLOCK} deep")
            routine.cost += 1
            match node:
                case Function():
                    # The innermost scope is searched first; of two functions with one name the last counts.
                    routine.functions[node.name] = self.declare(node, routine, depth)
                case Assign():
                    self._assign(routine, node)
                case CallStatement():
                    self._expression(routine, node.call, 1)
                case If():
                    if len(node.branches) > MOST_BRANCHES:
                        raise CompileError(*node.place, f"An if can have {MOST_BRANCHES} branches")
                    for condition, body in node.branches:
                        self._expression(routine, condition, 1)
                        self._block(routine, body, depth + 1, loops)
                    self._block(routine, node.otherwise, depth + 1, loops)
                case While():
                    if loops == DEEPEST_LOOP:
                        raise CompileError(*node.place, f"Loops can be nested {DEEPEST_LOOP} deep")
                    routine.waits = True
                    self._expression(routine, node.condition, 1)
                    self._block(routine, node.body, depth + 1, loops + 1)
                case Return():
                    if node.value is not None:
                        self._expression(routine, node.value, 1)
                case Simple():
                    if node.keyword in ("break", "continue") and not loops:
                        raise CompileError(*node.place, f"{node.keyword} outside of a loop")
                case OnThread():
                    routine.waits |= node.keyword == "join"
                    self._expression(routine, node.handle, 1)

    def _assign(self, routine: Routine, node: Assign) -> None:
        self._expression(routine, node.value, 1)
        target = node.target
        if isinstance(target, Name):
            names = {"global": self.globals, "local": routine.own, "": routine.assigned}[node.scope]
            names.add(target.name)
        else:
            self._expression(routine, target, 1)

    def _expression(self, routine: Routine, node: Expression, depth: int) -> None:
        if depth > DEEPEST_EXPRESSION:
            raise CompileError(*node.place, f"An expression can be nested {DEEPEST_EXPRESSION} deep: use variables")
        routine.cost += 1
        if isinstance(node, Call) and node.base is None:
            routine.calls.append(node)
        for child in children(node):
            self._expression(routine, child, depth + 1)


def children(node: Expression) -> Iterator[Expression]:
    """Yield the expressions directly inside `node`."""
    match node:
        case Constant() | Name():
            pass
        case ListLiteral():
            yield from node.items
        case Index():
            yield node.base
            yield from node.items
        case Field():
            yield node.base
        case Call():
            if node.base is not None:
                yield node.base
            for argument in node.arguments:
                yield argument.value
        case Unary():
            yield node.operand
        case Binary():
            yield node.left
            yield node.right


def not_found(place: Place, name: str) -> CompileError:
    """Return the error in a real controller's words, which the tests of UR's client library quote."""
    return CompileError(*place, f"compile_error_name_not_found:{name}:")
