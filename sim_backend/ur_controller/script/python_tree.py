"""Nodes of a Python syntax tree that carry the place in the script's text."""

import ast
from collections.abc import Iterable
from typing import Any, TypeVar

from .syntax import Place

Node = TypeVar("Node", bound=ast.AST)


def at(place: Place, node: Node) -> Node:
    """Return `node` with `place` set."""
    line, column = place
    for name, value in (("lineno", line), ("end_lineno", line), ("col_offset", column - 1), ("end_col_offset", column)):
        setattr(node, name, value)
    return node


def load(place: Place, name: str) -> ast.Name:
    """A read of a name."""
    return at(place, ast.Name(id=name, ctx=ast.Load()))


def store(place: Place, name: str) -> ast.Name:
    """A name to assign to."""
    return at(place, ast.Name(id=name, ctx=ast.Store()))


def constant(place: Place, value: Any) -> ast.Constant:
    """A literal."""
    return at(place, ast.Constant(value=value))


def call(place: Place, name: str, arguments: Iterable[ast.expr] = ()) -> ast.Call:
    """A call of `name` with arguments by position."""
    return at(place, ast.Call(func=load(place, name), args=list(arguments), keywords=[]))


def wait_for(place: Place, generator: ast.expr) -> ast.expr:
    """The result of a generator; each of its waits is passed on."""
    return at(place, ast.YieldFrom(value=generator))


def assign(place: Place, name: str, value: ast.expr) -> ast.stmt:
    """`name = value`."""
    return at(place, ast.Assign(targets=[store(place, name)], value=value))


def named(place: Place, name: str, value: ast.expr) -> ast.expr:
    """`(name := value)`."""
    return at(place, ast.NamedExpr(target=store(place, name), value=value))


def item(place: Place, value: ast.expr, index: int) -> ast.expr:
    """`value[index]`."""
    return at(place, ast.Subscript(value=value, slice=constant(place, index), ctx=ast.Load()))


def statement(place: Place, value: ast.expr) -> ast.stmt:
    """An expression as a statement."""
    return at(place, ast.Expr(value=value))


def wait(place: Place, signal: int | None) -> ast.stmt:
    """`yield signal`."""
    return statement(place, at(place, ast.Yield(value=constant(place, signal))))


def if_(place: Place, test: ast.expr, body: list[ast.stmt], orelse: list[ast.stmt] | None = None) -> ast.stmt:
    """`if test: body else: orelse`."""
    return at(place, ast.If(test=test, body=body, orelse=orelse or []))


def while_(place: Place, test: ast.expr, body: list[ast.stmt]) -> ast.stmt:
    """`while test: body`."""
    return at(place, ast.While(test=test, body=body, orelse=[]))


def _left(place: Place, context: ast.expr_context) -> ast.Attribute:
    return at(place, ast.Attribute(value=load(place, "_budget"), attr="left", ctx=context))


def take(place: Place, cost: int) -> ast.stmt:
    """Take `cost` from the budget."""
    return at(place, ast.AugAssign(target=_left(place, ast.Store()), op=ast.Sub(), value=constant(place, cost)))


def take_or_wait(place: Place, cost: int, signal: int) -> list[ast.stmt]:
    """Take `cost` from the budget, and wait with `signal` if nothing is left."""
    compare = ast.Compare(left=_left(place, ast.Load()), ops=[ast.Lt()], comparators=[constant(place, 0)])
    return [take(place, cost), if_(place, at(place, compare), [wait(place, signal)])]


def is_name(place: Place, left: str, right: str) -> ast.expr:
    """`left is right`."""
    return at(place, ast.Compare(left=load(place, left), ops=[ast.Is()], comparators=[load(place, right)]))


def finally_(place: Place, body: list[ast.stmt], last: ast.stmt) -> ast.stmt:
    """`try: body finally: last`."""
    return at(place, ast.Try(body=body, handlers=[], orelse=[], finalbody=[last]))


def define(place: Place, name: str, parameters: Iterable[str], body: list[ast.stmt]) -> ast.stmt:
    """`def name(parameters): body`."""
    arguments = ast.arguments(
        posonlyargs=[],
        args=[at(place, ast.arg(arg=parameter)) for parameter in parameters],
        kwonlyargs=[],
        kw_defaults=[],
        defaults=[],
    )
    return at(place, ast.FunctionDef(name=name, args=arguments, body=body, decorator_list=[]))
