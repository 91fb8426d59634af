"""Fuzzes URScript: any text is refused or runs a few ticks, and fails only in the script's own words."""

from collections.abc import Generator

import atheris
from fuzzing import fuzz

PURE = [f"sim_backend.ur_controller.builtins.{name}" for name in ("mathematics", "poses", "strings")]
with atheris.instrument_imports(include=["sim_backend.ur_controller.script", *PURE]):
    from sim_backend.ur_controller.builtins.mathematics import MATHEMATICS
    from sim_backend.ur_controller.builtins.poses import POSES
    from sim_backend.ur_controller.builtins.strings import STRINGS
    from sim_backend.ur_controller.script import (
        Builtin,
        CompileError,
        Execution,
        ScriptRuntimeError,
        State,
        Value,
        compile_source,
    )


def out(value: Value) -> None:
    del value


def move(q: Value, t: Value = 0) -> Generator[None]:
    del q, t
    yield


TABLE = {**MATHEMATICS, **STRINGS, **POSES, "out": Builtin.of(out), "move": Builtin.of(move)}

WORDS = [
    *(" def f(x, y = 1):\n", " thread t():\n", " sec s():\n", " end\n", " if ", ":\n", " elif ", " else:\n", " while "),
    *(" return ", " return\n", " break\n", " continue\n", " halt\n", " enter_critical\n", " exit_critical\n", " join "),
    *(" kill ", " run t()", " global ", " local ", " and ", " or ", " xor ", " not ", "True", "False", "0", "1", "2.5"),
    *("(", ")", "[", "]", ",", ".", " = ", " == ", " != ", " < ", " >= ", " + ", " - ", " * ", " / ", " % ", "a", "b"),
    *("f(", "out(", "move(", "sync()\n", "sleep(0.002)\n", "struct(a = ", "p[1,2,3,4,5,6]", "[1,2]", '"text"', "p"),
    *(".a", ".append(", ".pop()", ".length()", "to_str(", "str_cat(", "inv(", "pose_trans(", "norm(", "make_list("),
    *("\n", "# comment\n", '$ 1 "label"\n', "0xFF", "1e308", "-1", "a = 1\n", "b = [1, 2, 3]\n", "while True:\n"),
]
FORESEEN = (ScriptRuntimeError, NameError, ZeroDivisionError)


def text_of(data: bytes) -> str:
    """A script: words, one for each byte, after a zero; else the bytes themselves."""
    if data[:1] == b"\0":
        return "".join(WORDS[byte % len(WORDS)] for byte in data[1:])
    return data.decode("utf-8", "replace")


def check(data: bytes) -> None:
    try:
        compiled = compile_source(text_of(data), TABLE)
    except CompileError:
        return
    execution = Execution(compiled, step_limit=1000)
    for _ in range(3):
        execution.step()
    if execution.state is State.FAILED:
        assert execution.error is not None
        assert isinstance(execution.error.__cause__, FORESEEN), execution.error
    execution.kill()


if __name__ == "__main__":
    fuzz(
        check,
        [
            b"def prog():\n  a = p[1,2,3,4,5,6]\n  a[0] = inv([[1,2],[3,4]])[1,0]\n  move(a, t = 1)\nend\n",
            b"thread t():\n  while True:\n    sync()\n  end\nend\nh = run t()\nkill h\n",
            b"def f(x, y = 1):\n  if x < y and not False:\n    return f(x + 1)\n  end\n  return x\nend\nout(f(0))\n",
            bytes([0, *range(len(WORDS))]),
        ],
    )
