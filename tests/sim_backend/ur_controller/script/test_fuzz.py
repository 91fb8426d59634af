"""Texts that nobody would write: they are refused, or run and fail in the script's own words."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_backend.ur_controller.script import CompileError, ScriptRuntimeError, State
from tests.sim_backend.ur_controller.script.runs import Run, value

FORESEEN = (ScriptRuntimeError, NameError, ZeroDivisionError)
"""Errors that a script can bring about; any other is a mistake of the runtime."""

WORDS = [
    "def",
    "thread",
    "sec",
    "end",
    "if",
    "elif",
    "else",
    "while",
    "return",
    "break",
    "continue",
    "halt",
    "enter_critical",
    "exit_critical",
    "join",
    "kill",
    "run",
    "global",
    "local",
    "and",
    "or",
    "xor",
    "not",
    "True",
    "False",
    "struct",
    "a",
    "b",
    "f",
    "g",
    "p",
    "sync",
    "sleep",
    "out",
    "move",
    "append",
    "pop",
    "length",
    "(",
    ")",
    "[",
    "]",
    ":",
    ",",
    ".",
    "=",
    "==",
    "!=",
    "<",
    "<=",
    ">",
    ">=",
    "+",
    "-",
    "*",
    "/",
    "%",
    "1",
    "2.5",
    "1e3",
    "0x1F",
    '"text"',
    "\n",
    "# comment\n",
    '$ 1 "label"\n',
    "p[1,2,3,4,5,6]",
    "[1, 2]",
    "while True:\n",
    "a = ",
    "end\n",
]


def survive(text: str) -> None:
    """A text is refused, or runs for a few ticks."""
    try:
        run = Run(text, step_limit=1000)
    except CompileError:
        return
    run.step(5)
    if run.execution.state is State.FAILED:
        assert run.execution.error is not None
        assert isinstance(run.execution.error.__cause__, FORESEEN)
    run.execution.kill()


@settings(max_examples=150, deadline=None)
@given(st.lists(st.sampled_from(WORDS), max_size=60).map(" ".join))
def test_any_words_are_refused_or_run(text: str) -> None:
    survive(text)


@settings(max_examples=150, deadline=None)
@given(st.text(max_size=200))
def test_any_text_is_refused_or_runs(text: str) -> None:
    survive(text)


names = st.sampled_from(["a", "b", "p", "struct", "async", "x1"])
leaves = st.one_of(
    st.integers(-5, 300).map(str),
    st.floats(0, 1e6).map(repr),
    names,
    st.sampled_from(["True", "False", '"s"', "[]", "p[1,2,3,4,5,6]", "[[1,2],[3,4]]", "struct(a = 1, b = [2])"]),
)
operators = st.sampled_from(["+", "-", "*", "/", "%", "==", "!=", "<", "<=", ">", ">=", "and", "or", "xor"])
expressions = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.tuples(inner, operators, inner).map(lambda parts: f"({' '.join(parts)})"),
        st.tuples(st.sampled_from(["-", "+", "not "]), inner).map(lambda parts: f"({''.join(parts)})"),
        st.lists(inner, max_size=4).map(lambda items: f"[{', '.join(items)}]"),
        st.tuples(inner, inner).map(lambda parts: f"{parts[0]}[{parts[1]}]"),
        inner.map(lambda base: f"{base}.a"),
        st.tuples(inner, st.sampled_from(["length()", "append(1)", "pop()", "insert(0, 2)"])).map(".".join),
        st.tuples(st.sampled_from(["to_str", "norm", "inv", "size", "floor", "f", "move"]), inner).map(
            lambda parts: f"{parts[0]}({parts[1]})"
        ),
    ),
    max_leaves=12,
)
statements = st.recursive(
    st.one_of(
        st.tuples(names, expressions).map(" = ".join),
        st.tuples(st.sampled_from(["global ", "local "]), names, expressions).map(lambda p: f"{p[0]}{p[1]} = {p[2]}"),
        st.tuples(names, expressions, expressions).map(lambda parts: "{}[{}] = {}".format(*parts)),
        expressions.map(lambda inner: f"out({inner})"),
        st.sampled_from(["sync()", "run t()", "kill run t()", "join 1", "enter_critical", "exit_critical", "halt"]),
    ),
    lambda inner: st.one_of(
        st.tuples(expressions, st.lists(inner, max_size=3).map("\n".join)).map(lambda p: f"if {p[0]}:\n{p[1]}\nend"),
        st.tuples(expressions, st.lists(inner, max_size=3).map("\n".join)).map(lambda p: f"while {p[0]}:\n{p[1]}\nend"),
    ),
    max_leaves=8,
)
PRELUDE = "a = 1 b = [1, 2] p = 3 struct = 4 async = 5 x1 = 6\ndef f(x): return x end\nthread t(): sync() end\n"


@settings(max_examples=150, deadline=None)
@given(st.lists(statements, max_size=6).map("\n".join))
def test_any_well_formed_program_runs_or_fails_in_the_script_s_own_words(body: str) -> None:
    survive(PRELUDE + body)


calculations = st.recursive(
    st.one_of(st.integers(0, 50).map(str), st.floats(0.01, 50).map(repr)),
    lambda inner: st.tuples(inner, st.sampled_from(["+", "-", "*"]), inner).map(lambda p: f"({' '.join(p)})"),
    max_leaves=10,
)


@settings(max_examples=150, deadline=None)
@given(calculations)
def test_arithmetic_is_that_of_numbers(text: str) -> None:
    expected = eval(text)  # noqa: S307  # numbers, signs and parentheses
    assert value(text) == pytest.approx(expected, rel=1e-12)
