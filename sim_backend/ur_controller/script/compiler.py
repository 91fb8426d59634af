"""Compiler from a syntax tree to Python code.

Each function of the script becomes a Python function, or a generator if it can wait for the next tick; threads and
programs are generators. The Python tree is built node by node, never as text, and its names cannot reach the host: a
variable x becomes `v_x` or, if global, `g_x`, a function `f<number>_x`, a builtin `b_x`; all other names in the code
begin with an underscore. There are no Python builtins, and the only attribute accessed is the budget's. Lines and
columns are those of the script, so Python's own traceback locates a failure in the script.
"""

import ast
from collections.abc import Sequence
from dataclasses import dataclass
from types import CodeType
from typing import Any, Final, Literal

from .analysis import BUILTIN_COST, Analysis, Routine
from .budget import EXHAUSTED
from .builtin import Builtin, Table
from .errors import CompileError
from .expressions import ExpressionCompiler, python_name
from .parser import parse
from .python_tree import (
    assign,
    at,
    call,
    constant,
    define,
    finally_,
    if_,
    is_name,
    load,
    statement,
    take,
    take_or_wait,
    wait,
    while_,
)
from .syntax import (
    Assign,
    Block,
    CallStatement,
    Expression,
    Field,
    Function,
    If,
    Index,
    Name,
    OnThread,
    Parameter,
    Place,
    Return,
    Simple,
    Statement,
    While,
)
from .timing import sleep, sync

FILE_NAME: Final = "<script>"
MAIN: Final = "_main"
CHEAP_BRANCH: Final = 8
"""Largest cost, in operations, of a branch that is charged whether it runs or not."""
LONGEST_STRETCH: Final = 50
"""Operations, approximately, from one check of the budget to the next in code without a loop."""
_FLOW: Final[Table] = {"sync": Builtin.of(sync), "sleep": Builtin.of(sleep)}


@dataclass(frozen=True, slots=True)
class Compiled:
    """A script ready to run, any number of times.

    Attributes:
        name: name of the `def` or `sec`; "unnamed" for loose statements.
        kind: a `sec` is "secondary": it runs beside the program and takes no time.
        code: defines the script's functions in a copy of `names`.
    """

    name: str
    kind: Literal["program", "secondary"]
    code: CodeType
    names: dict[str, Any]


def compile_source(text: str, builtins: Table) -> Compiled:
    """Compile the program that a controller runs when it receives `text`.

    A single `def` or `sec` without parameters is the program; of several functions and nothing else, the last one is.
    Anything else is the body of a program without a name. `sync` and `sleep` belong to the language and need not be in
    `builtins`.

    Raises:
        CompileError: the text is not a script, calls or reads unknown names, or passes wrong arguments.
    """
    block = parse(text)
    table = {**_FLOW, **builtins}
    analysis = Analysis(table)
    root = analysis.declare(block)
    last = block[-1] if block else None
    main, body, before = root, block, ()
    if isinstance(last, Function) and _can_start(last) and all(isinstance(node, Function) for node in block):
        main, body, before = analysis.routines[id(last)], last.body, block[:-1]
    analysis.resolve(main)
    compiler = _StatementCompiler(analysis, table, root)
    for node in before:
        compiler.statement(node)
    compiler.define(main, MAIN, (), body, (1, 1))
    try:
        code = compile(ast.Module(body=compiler.definitions, type_ignores=[]), FILE_NAME, "exec", dont_inherit=True)
    except (RecursionError, SyntaxError) as error:
        raise CompileError(0, 0, f"The script is nested too deeply: {error}") from None
    return Compiled(main.name, "secondary" if main.keyword == "sec" else "program", code, compiler.names)


def _can_start(function: Function) -> bool:
    return function.keyword != "thread" and not function.parameters


class _StatementCompiler(ExpressionCompiler):
    def __init__(self, analysis: Analysis, builtins: Table, main: Routine) -> None:
        super().__init__(analysis, builtins, main)
        self.definitions: list[ast.stmt] = []

    def define(self, routine: Routine, name: str, parameters: Sequence[Parameter], body: Block, place: Place) -> None:
        """Add the Python function of `routine`."""
        outer = self.routine, self.stored, self.cost
        self.routine, self.stored, self.cost = routine, set(), 1
        statements: list[ast.stmt] = []
        for parameter in parameters:
            if parameter.default is not None:
                variable, where = "v_" + parameter.name, parameter.place
                given = assign(where, variable, self.expression(parameter.default))
                statements.append(if_(where, is_name(where, variable, "_missing"), [given]))
        statements += self._block(body, place)
        if routine.waits:
            statements = [*take_or_wait(place, self.cost, EXHAUSTED), *statements]
        if routine.deep:
            leave = statement(place, call(place, "_leave_call", [load(place, "_thread")]))
            statements = [
                assign(place, "_thread", call(place, "_enter_call")),
                finally_(place, statements, leave),
            ]
        if self.stored:
            statements.insert(0, at(place, ast.Global(names=sorted(self.stored))))
        self.definitions.append(define(place, name, ["v_" + p.name for p in parameters], statements))
        self.routine, self.stored, self.cost = outer

    def statement(self, node: Statement) -> list[ast.stmt]:
        """Return the code for one statement; a function adds its own definition and no code here."""
        self.cost += 1
        place = node.place
        match node:
            case Function():
                routine = self._analysis.routines[id(node)]
                self.define(routine, python_name(routine), node.parameters, node.body, place)
                return []
            case Assign():
                return [self._assign(node)]
            case CallStatement():
                return [statement(place, self.expression(node.call))]
            case If():
                return self._if(node)
            case While():
                return [self._while(node)]
            case Return():
                value = None if node.value is None else self.expression(node.value)
                return [at(place, ast.Return(value=value))]
            case Simple():
                return [self._simple(node)]
            case OnThread():
                handle = self.expression(node.handle)
                self.cost += BUILTIN_COST
                if node.keyword == "kill":
                    return [statement(place, call(place, "_kill", [handle]))]
                runs = call(place, "_runs", [load(place, "_t")])
                return [assign(place, "_t", handle), while_(place, runs, [wait(place, None)])]

    def _block(self, block: Block, place: Place) -> list[ast.stmt]:
        statements: list[ast.stmt] = []
        for node in block:
            statements += self.statement(node)
            if self.routine.waits and self.cost > LONGEST_STRETCH:
                statements += take_or_wait(node.place, self.cost, EXHAUSTED)
                self.cost = 0
        return statements or [at(place, ast.Pass())]

    def _assign(self, node: Assign) -> ast.stmt:
        place, value = node.place, self.expression(node.value)
        path: list[ast.expr] = []
        target: Expression = node.target
        while not isinstance(target, Name):
            match target:
                case Index():
                    path[:0] = map(self.expression, target.items)
                    target = target.base
                case Field():
                    path.insert(0, constant(target.place, target.name))
                    target = target.base
                case _:
                    raise CompileError(*target.place, "Only a variable, an element or a field of one can be assigned")
        variable = self.target(target.place, target.name)
        if path:
            value = call(place, "_replaced", [self.expression(target), value, *path])
        return assign(place, variable, value)

    def _if(self, node: If) -> list[ast.stmt]:
        place = node.place
        branches = [(self.condition(test), self._branch(body, place)) for test, body in node.branches]
        made = self._branch(node.otherwise, place) if node.otherwise else []
        for test, body in reversed(branches):
            made = [if_(place, test, body, made)]
        return made

    def _branch(self, block: Block, place: Place) -> list[ast.stmt]:
        outer, self.cost = self.cost, 0
        made = self._block(block, place)
        if self.routine.waits and self.cost > CHEAP_BRANCH:
            made.insert(0, take(place, self.cost))
            self.cost = 0
        self.cost += outer
        return made

    def _while(self, node: While) -> ast.stmt:
        outer, self.cost = self.cost, 1
        test = self.condition(node.condition)
        body = self._block(node.body, node.place)
        cost, self.cost = self.cost, outer
        return while_(node.place, test, [*take_or_wait(node.place, cost, EXHAUSTED), *body])

    def _simple(self, node: Simple) -> ast.stmt:
        if node.keyword == "break":
            return at(node.place, ast.Break())
        if node.keyword == "continue":
            return at(node.place, ast.Continue())
        return statement(node.place, call(node.place, "_" + node.keyword))
