"""Scripts come over the network: whatever they hold, they neither reach the host nor take it down."""

import dis
import tracemalloc
from types import CodeType

import pytest

from sim_backend.ur_controller.script import Builtin, CompileError, Execution, State, compile_source, runtime
from sim_backend.ur_controller.script.compiler import Compiled
from sim_backend.ur_controller.script.parser import LONGEST_SOURCE, parse
from tests.sim_backend.ur_controller.script.runs import Run, error, value

DEEP = 20_000


@pytest.mark.parametrize(
    "text",
    [
        "x = " + "[" * DEEP + "]" * DEEP,
        "x = " + "- " * DEEP + "1",
        "x = " + "not " * DEEP + "True",
        "x = " + "1 + " * DEEP + "1",
        "x = " + "1 == 1 and " * DEEP + "True",
        "x = [1] x = x" + "[0]" * DEEP,
        "x = 1 x = x" + ".a" * DEEP,
        "x = [1] x" + "[0]" * DEEP + " = 1",
        "x = " + "sin(" * DEEP + "1" + ")" * DEEP,
        "if True: " * DEEP + "end " * DEEP,
        "while True: " * 25 + "end " * 25,
        "def f(): " * DEEP + "end " * DEEP,
        "if True: " + "def f(): if True: while False: " * 200 + "end end end " * 200 + "end",
        "if True: x = 1 " + "elif False: x = 2 " * 2_000 + "end",
        "x = " + "(" * DEEP,
        "def f(): " * DEEP,
        "x = 1 " * (LONGEST_SOURCE // 6 + 1),
        'x = "' + "a" * LONGEST_SOURCE + '"',
    ],
)
def test_what_is_too_deep_or_too_long_is_refused(text: str) -> None:
    with pytest.raises(CompileError):
        compile_source(text, {"sin": Builtin.of(lambda x: x)})


def test_long_programs_that_are_no_deeper_than_others_run() -> None:
    branches = "".join(f"elif x == {i}:\n  out({i})\n" for i in range(1, 290))
    assert Run(f"x = 250\nif x == 0:\n{branches}end").to_end().printed == [250]
    assert value(" + ".join(["1"] * 100)) == 100
    assert value("(" * 5_000 + "1" + ")" * 5_000) == 1  # parentheses leave nothing behind
    assert Run("n = 0\n" + "n = n + 1\n" * 10_000 + "out(n)").to_end().printed == [10_000]


@pytest.mark.parametrize(
    "text",
    [
        's = "x"\nwhile True:\n  s = s + s\nend',
        's = "x"\nwhile True:\n  s = str_cat(s, s)\nend',
        "l = [1]\nwhile True:\n  l.append(1)\nend",
        "l = [1]\nwhile True:\n  l = [l, l]\nend",
        "l = [1]\nwhile True:\n  l = [l, l, l, l]\n  l = l[0]\n  l[0] = [l, l]\nend",
        "s = struct(a = 1)\nwhile True:\n  s = struct(a = s, b = s)\nend",
        "s = struct(a = 1)\nwhile True:\n  s.a = s\nend",
        "m = [[1]]\nm[0, 0] = [[1]]\nwhile True:\n  m = [m, m]\nend",
        "l = make_list(4096, make_list(4096, 0))",
        "l = make_list(4096, struct(a = p[1,2,3,4,5,6]))",
        "l = make_list(64, 1.0)\nm = [l]\nm = transpose(m) * m\nm = m * transpose(l) * l * [m]",
    ],
)
def test_values_are_bounded_in_size_and_depth(text: str) -> None:
    tracemalloc.start()
    try:
        run = Run(text).step(300)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert run.execution.state is State.FAILED
    assert peak < 20e6


def test_a_program_that_needs_too_much_memory_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    text = "l = make_list(4096, 1.5)\nwhile True:\n  sync()\nend"
    assert Run(text).step(5).execution.state is State.RUNNING
    monkeypatch.setattr(runtime, "MOST_MEMORY_KIB", -1)
    assert "memory" in error(text)[2]


@pytest.mark.parametrize("statement", ["y = x + 1.5", "y = f(x)", "y = inv(m)", "if True: y = x * 2 end"])
def test_a_tick_ends_between_statements_without_a_loop_too(statement: str) -> None:
    start = "def f(x): return x + 1 end x = make_list(4096, 1.5) m = [[2, 1], [1, 2]] out(0)\n"
    run = Run(start + f"{statement}\n" * 400 + "out(1)").to_end()
    assert run.ticks[1] - run.ticks[0] > 5


def test_a_statement_that_takes_far_more_than_a_tick_fails() -> None:
    assert "too much work" in error("x = make_list(4096, 1.5)\ny = [" + "x + 1, " * 1000 + "x]")[2]


def test_literals_are_bounded_as_other_values() -> None:
    with pytest.raises(CompileError, match="4096 elements"):
        compile_source("x = [" + "1, " * 4096 + "1]", {})
    with pytest.raises(CompileError, match="1023 characters"):
        compile_source('x = "' + "a" * 1024 + '"', {})
    assert value('str_len("' + "a" * 1023 + '")') == 1023


def test_threads_that_have_ended_leave_nothing_behind() -> None:
    text = "thread t():\n  sync()\nend\nenter_critical\nwhile True:\n  kill run t()\n{}end"
    assert "threads" in error(text.format(""))[2]
    run = Run(text.format("  sync()\n")).step(20)
    tracemalloc.start()
    try:
        run.step(200)
        size, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert run.execution.state is State.RUNNING
    assert size < 1e6


def test_a_list_can_be_as_long_as_its_bound_and_no_longer() -> None:
    text = "n = 0\nl = []\nwhile True:\n  l.append(n)\n  n = n + 1\nend"
    assert error(text, 1000)[2] == "A list cannot have more than 4096 elements"


def loaded_names(code: CodeType) -> set[str]:
    """Names and attributes that compiled code, with all that is nested in it, can ask for."""
    names = set(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            names |= loaded_names(constant)
    return names


def attributes(code: CodeType) -> set[str]:
    """Attributes that compiled code can ask for."""
    found = {i.argval for i in dis.get_instructions(code) if "ATTR" in i.opname or "METHOD" in i.opname}
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            found |= attributes(constant)
    return found


HOSTILE = """
def __import__(__builtins__, self = [1], x = "__class__"):
  global __name__ = struct(__class__ = 1, __dict__ = 2)
  exec = __name__.__class__
  _budget = [exec, self]
  __name__.__dict__ = x
  _main = _budget[0]
  return _main
end
thread __del__():
  open = 1
end
_run = run __del__()
_kill = __import__(5)
getattr = [1]
getattr.append(2)
out(_kill)
"""


def test_names_of_a_script_never_reach_the_host() -> None:
    run = Run(HOSTILE)
    assert run.to_end().printed == [1]
    compiled: Compiled = compile_source(HOSTILE, {"out": Builtin.of(lambda x: None)})
    assert attributes(compiled.code) == {"left"}
    for name in loaded_names(compiled.code) - {"left"}:
        assert name[:2] in ("v_", "g_", "b_") or name.startswith("_") or name[0] == "f"
    assert compiled.names["__builtins__"] == {}
    own = loaded_names(compiled.code) & {"__import__", "__builtins__", "exec", "open", "getattr", "_thread", "__name__"}
    assert own == set()


@pytest.mark.parametrize(
    "text",
    [
        "x = [1].__class__",
        "x = struct(a = 1).__class__",
        'x = "a".__class__',
        "x = [1].__len__()",
        'x = "a".format()',
        "x = struct(a = 1).keys()",
        "x = [1] x.sort()",
        'x = struct(a = 1) y = x["a"]',
        "x = [1] x.__class__ = 1",
        "def f(): end x = f() x.y = 1",
    ],
)
def test_no_value_has_attributes_of_the_host(text: str) -> None:
    assert error(text)[2]


@pytest.mark.parametrize("name", ["__import__", "open", "eval", "print", "_kill", "_run", "_budget", "b_out", "f0_f"])
def test_what_the_compiled_code_uses_is_unknown_to_the_script(name: str) -> None:
    for text in (f"x = {name}", f"{name}(1)", f"run {name}()"):
        with pytest.raises(CompileError, match="name_not_found"):
            compile_source(text, {})


def test_a_text_that_was_parsed_is_not_parsed_again() -> None:
    text = "a = 1\n" * 50
    assert parse(text) is parse(text)


def test_two_runs_of_one_script_share_nothing() -> None:
    compiled = compile_source("n = 0\nwhile True:\n  n = n + 1\n  sync()\n  if n > 3:\n    halt\n  end\nend", {})
    first, second = Execution(compiled), Execution(compiled)
    for _ in range(5):
        first.step()
    second.step()
    assert first.state is State.FINISHED
    assert second.state is State.RUNNING
