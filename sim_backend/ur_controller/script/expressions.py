"""Compiler from expressions of a script to Python expressions.

Not in UR's script manual: operators bind as in Python, with `xor` between `or` and `and`; `and` and `or` skip their
right side when the left one decides.
"""

import ast
from collections.abc import Sequence
from typing import Any, Final

from . import arithmetic
from .analysis import BUILTIN_COST, Analysis, Routine, not_found
from .budget import BUDGET
from .builtin import REQUIRED, Table
from .errors import CompileError
from .python_tree import at, call, constant, item, load, named, wait_for
from .syntax import (
    Argument,
    Binary,
    Call,
    Constant,
    Expression,
    Field,
    Index,
    ListLiteral,
    Name,
    Place,
    Unary,
)
from .values import LARGEST_LIST, Pose

_OPERATORS: Final = {
    "+": "add",
    "-": "subtract",
    "*": "multiply",
    "/": "divide",
    "%": "modulo",
    "==": "equal",
    "!=": "unequal",
    "<": "less",
    "<=": "less_or_equal",
    ">": "greater",
    ">=": "greater_or_equal",
}
_BOOLEAN: Final = frozenset({"==", "!=", "<", "<=", ">", ">=", "and", "or", "xor", "not"})


class ExpressionCompiler:
    """Compiles the expressions of one script; the compiler of statements derives from it.

    Attributes:
        names: names available to the code besides its own functions.
        routine: function whose code is being made.
        stored: Python names of global variables that the function assigns.
        cost: operations of the code made since the cost was last set to 0.

    Raises:
        CompileError: a name or an argument is wrong; reports the first in the order of the text.
    """

    def __init__(self, analysis: Analysis, builtins: Table, main: Routine) -> None:
        self._analysis = analysis
        self._builtins = builtins
        self.names: dict[str, Any] = {
            "__builtins__": {},
            "_budget": BUDGET,
            "_missing": REQUIRED,
            "_condition": arithmetic.condition,
            "_list": arithmetic.make_list,
            "_pose": arithmetic.make_pose,
            "_struct": arithmetic.make_struct,
            "_element": arithmetic.element,
            "_field": arithmetic.field,
            "_replaced": arithmetic.replaced,
            "_method": arithmetic.method,
            "_negate": arithmetic.negate,
            "_identity": arithmetic.identity,
        }
        self.names.update((f"_{name}", getattr(arithmetic, name)) for name in _OPERATORS.values())
        self.routine = main
        self.stored: set[str] = set()
        self.cost = 0

    def target(self, place: Place, name: str) -> str:
        """Return the Python name of a variable that is assigned."""
        if self._analysis.is_local(self.routine, name):
            return "v_" + name
        if name not in self._analysis.globals:
            raise not_found(place, name)
        self.stored.add("g_" + name)
        return "g_" + name

    def expression(self, node: Expression) -> ast.expr:
        """Return the code for the value of `node`."""
        self.cost += 1
        place = node.place
        match node:
            case Constant():
                return constant(place, node.value)
            case Name():
                return self._variable(place, node.name)
            case ListLiteral():
                if len(node.items) > LARGEST_LIST:
                    raise CompileError(*place, f"A list cannot have more than {LARGEST_LIST} elements")
                fixed = _fixed(node)
                if fixed is not None:
                    return load(place, self._keep(fixed))
                return call(place, "_pose" if node.pose else "_list", map(self.expression, node.items))
            case Index():
                return call(place, "_element", map(self.expression, (node.base, *node.items)))
            case Field():
                return call(place, "_field", [self.expression(node.base), constant(place, node.name)])
            case Call():
                return self._call(node)
            case Unary():
                return self._unary(node)
            case Binary():
                return self._binary(node)

    def condition(self, node: Expression) -> ast.expr:
        """Return the code for `node` as True or False."""
        value = self.expression(node)
        if isinstance(node, Unary | Binary) and node.operator in _BOOLEAN:
            return value
        return value if isinstance(node, Constant) and isinstance(node.value, bool) else self._truth(node, value)

    def _truth(self, node: Expression, value: ast.expr) -> ast.expr:
        return call(node.place, "_condition", [value])

    def _variable(self, place: Place, name: str) -> ast.expr:
        if self._analysis.is_local(self.routine, name):
            return load(place, "v_" + name)
        if name not in self._analysis.globals:
            raise not_found(place, name)
        return load(place, "g_" + name)

    def _keep(self, value: Any) -> str:
        name = f"_constant{len(self.names)}"
        self.names[name] = value
        return name

    def _unary(self, node: Unary) -> ast.expr:
        place = node.place
        if node.operator == "not":
            return at(place, ast.UnaryOp(op=ast.Not(), operand=self.condition(node.operand)))
        fixed = _fixed(node)
        if fixed is not None:
            return constant(place, fixed)
        return call(place, "_negate" if node.operator == "-" else "_identity", [self.expression(node.operand)])

    def _binary(self, node: Binary) -> ast.expr:
        place = node.place
        if node.operator in ("and", "or"):
            both = [self.condition(node.left), self.condition(node.right)]
            return at(place, ast.BoolOp(op=ast.And() if node.operator == "and" else ast.Or(), values=both))
        if node.operator == "xor":
            left, right = self.condition(node.left), self.condition(node.right)
            return at(place, ast.Compare(left=left, ops=[ast.NotEq()], comparators=[right]))
        operands = [self.expression(node.left), self.expression(node.right)]
        return call(place, f"_{_OPERATORS[node.operator]}", operands)

    def _call(self, node: Call) -> ast.expr:
        place = node.place
        if node.base is not None:
            return self._method(node, node.base)
        routine = self.routine.find(node.name)
        if routine is None and node.name == "struct" and not node.thread:
            return self._struct(node)
        if routine is None and node.name not in self._builtins:
            raise not_found(place, node.name)
        if routine is not None:
            return self._call_routine(node, routine)
        if node.thread:
            raise CompileError(*place, f"run starts a thread, and {node.name} is a function")
        builtin = self._builtins[node.name]
        arguments = self._bind(node, [(p.name, p.default is REQUIRED) for p in builtin.parameters])
        while arguments and arguments[-1] is None:
            arguments.pop()
        self.cost += BUILTIN_COST
        self.names["b_" + node.name] = builtin.call
        given = [
            load(place, self._keep(builtin.parameters[index].default)) if argument is None else argument
            for index, argument in enumerate(arguments)
        ]
        called = call(place, "b_" + node.name, given)
        return wait_for(place, called) if builtin.blocking else called

    def _call_routine(self, node: Call, routine: Routine) -> ast.expr:
        place = node.place
        if node.thread != (routine.keyword != "def"):
            wrong = "run starts a thread, and {} is a function" if node.thread else "{} is a thread: start it with run"
            raise CompileError(*place, wrong.format(node.name))
        bound = self._bind(node, [(name, name not in routine.optional) for name in routine.parameters])
        arguments = [load(place, "_missing") if argument is None else argument for argument in bound]
        called = call(place, python_name(routine), arguments)
        if node.thread:
            self.cost += BUILTIN_COST
            return call(place, "_run", [constant(place, node.name), called])
        if routine.waits:
            return wait_for(place, called)
        self.cost += routine.cost
        return called

    def _bind(self, node: Call, parameters: Sequence[tuple[str, bool]]) -> list[ast.expr | None]:
        """Return one value for each parameter, given as name and required flag; None for an omitted one."""
        names = [name for name, _ in parameters]
        values: dict[str, ast.expr] = {}
        for position, argument in enumerate(node.arguments):
            name = argument.name
            if not name:
                if position >= len(names):
                    raise _wrong(node, argument, f"takes {len(names)} arguments, not {len(node.arguments)}")
                name = names[position]
            elif name not in names:
                raise _wrong(node, argument, f"has no parameter {name}, it has {', '.join(names) or 'none'}")
            if name in values:
                raise _wrong(node, argument, f"is given {name} twice")
            values[name] = self.expression(argument.value)
        missing = [name for name, required in parameters if required and name not in values]
        if missing:
            raise _wrong(node, node, f"needs {', '.join(missing)}")
        return [values.get(name) for name in names]

    def _struct(self, node: Call) -> ast.expr:
        names = tuple(argument.name for argument in node.arguments)
        if not all(names) or len(set(names)) != len(names) or not names:
            raise _wrong(node, node, "takes named values only, each name once")
        values = [self.expression(argument.value) for argument in node.arguments]
        return call(node.place, "_struct", [constant(node.place, names), *values])

    def _method(self, node: Call, base: Expression) -> ast.expr:
        place = node.place
        if any(argument.name for argument in node.arguments):
            raise _wrong(node, node, "takes its arguments by position")
        arguments = [self.expression(argument.value) for argument in node.arguments]
        done = call(place, "_method", [self.expression(base), constant(place, node.name), *arguments])
        if not isinstance(base, Name):
            return item(place, done, 1)
        both = named(place, "_t", done)
        kept = named(place, self.target(place, base.name), item(place, load(place, "_t"), 0))
        steps = [both, kept, item(place, load(place, "_t"), 1)]
        return item(place, at(place, ast.Tuple(elts=steps, ctx=ast.Load())), 2)


def python_name(routine: Routine) -> str:
    """Return the name of the Python function for a function of the script."""
    return f"f{routine.number}_{routine.name}"


def _wrong(node: Call, where: Argument | Call, text: str) -> CompileError:
    return CompileError(*where.place, f"{node.name} {text}")


def _fixed(node: Expression) -> Any:
    """Return the value of a literal that never changes, or None."""
    match node:
        case Constant() if not isinstance(node.value, str):
            return node.value
        case Unary(operator="-" | "+" as sign, operand=Constant(value=int() | float() as value)) if not isinstance(
            value, bool
        ):
            return -value if sign == "-" else value
        case ListLiteral() if node.items:
            values = [_fixed(value) for value in node.items]
            if any(value is None for value in values):
                return None
            if node.pose:
                return Pose(map(float, values)) if all(type(value) in (int, float) for value in values) else None
            return values if not any(isinstance(value, list) for value in values) else None
        case _:
            return None
