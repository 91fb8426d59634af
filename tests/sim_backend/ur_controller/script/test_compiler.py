"""Which program a text is, and what is refused before it runs."""

import pytest

from sim_backend.ur_controller.script import Builtin, CompileError, compile_source
from tests.sim_backend.ur_controller.script.runs import printed


def textmsg(s1: object, s2: object = "") -> None: ...


TABLE = {"textmsg": Builtin.of(textmsg)}


def refusal(text: str) -> tuple[int, int, str]:
    with pytest.raises(CompileError) as refused:
        compile_source(text, TABLE)
    return refused.value.line, refused.value.column, refused.value.text


@pytest.mark.parametrize(
    ("text", "name", "kind"),
    [
        ("def test_fun():\n  textmsg(1)\nend", "test_fun", "program"),
        ("# comment\ndef test_fun():\nend\n\n", "test_fun", "program"),
        ("sec test_sec():\n  textmsg(1)\nend", "test_sec", "secondary"),
        ('textmsg("a")\nsync()\n', "unnamed", "program"),
        ("def f(x):\nend", "unnamed", "program"),
        ("def f(x):\nend\ndef main():\n  f(1)\nend", "main", "program"),
        ("def f():\nend\nf()", "unnamed", "program"),
        ("", "unnamed", "program"),
        ("# only a comment", "unnamed", "program"),
    ],
)
def test_the_program_is_the_def_or_else_the_statements(text: str, name: str, kind: str) -> None:
    compiled = compile_source(text, TABLE)
    assert (compiled.name, compiled.kind) == (name, kind)


def test_the_last_of_several_functions_is_run_and_may_call_the_others() -> None:
    assert printed("def a():\n  return 5\nend\ndef b():\n  out(a())\nend") == [5]


def test_unknown_names_are_refused_in_the_words_of_a_real_controller() -> None:
    text = "def illegal_fun():\n  calldoesntexist()\nend"
    assert refusal(text) == (2, 3, "compile_error_name_not_found:calldoesntexist:")
    assert refusal("a = 1\nb = a + missing") == (2, 9, "compile_error_name_not_found:missing:")
    assert refusal("run nothing()") == (1, 1, "compile_error_name_not_found:nothing:")
    assert refusal("x[0] = 1")[2] == "compile_error_name_not_found:x:"


def test_a_name_that_is_local_elsewhere_is_unknown_here() -> None:
    text = "def f(a):\n  local b = a\n  return b\nend\nf(1)\ntextmsg(b)"
    assert refusal(text) == (6, 9, "compile_error_name_not_found:b:")


@pytest.mark.parametrize(
    ("text", "line", "column"),
    [
        ("a = = 1", 1, 5),
        ("def test_fun:\n  textmsg(1)\nend", 1, 13),
        ("def 7_eight_9():\nend", 1, 5),
        ('def test_fun():\n  textmsg("testing")', 2, 20),
        ("while True\nend", 2, 1),
        ("if True:\n  textmsg(1)\n", 2, 12),
        ('textmsg("open)', 1, 9),
        ("end", 1, 1),
        ("while = 1", 1, 7),
        ("x = end", 1, 5),
        ("a = 1 ; b = 2", 1, 7),
        ("a == 1 < 2", 1, 3),
        ("x = 1 < 2 < 3", 1, 11),
    ],
)
def test_what_is_no_script_is_refused_with_its_place(text: str, line: int, column: int) -> None:
    found = refusal(text)
    assert found[:2] == (line, column)
    assert found[2].startswith(f"syntax_error_on_line:{line}:")


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("textmsg()", (1, 1), "needs s1"),
        ("textmsg(1, 2, 3)", (1, 15), "takes 2 arguments, not 3"),
        ("textmsg(1, s1 = 2)", (1, 12), "given s1 twice"),
        ("textmsg(1, s3 = 2)", (1, 12), "no parameter s3"),
        ("def f(a, b = 1):\nend\nf()", (3, 1), "needs a"),
        ("def f(a, b = 1):\nend\nf(1, 2, 3)", (3, 9), "takes 2 arguments"),
        ("def f(a, a):\nend\nf(1, 2)", (1, 5), "one name"),
        ("thread t(x):\nend\nrun t()", (1, 8), "cannot have parameters"),
        ("def f():\nend\nrun f()", (3, 1), "is a function"),
        ("thread t():\nend\nt()", (3, 1), "start it with run"),
        ("run textmsg(1)", (1, 1), "is a function"),
        ("break", (1, 1), "outside of a loop"),
        ("while True:\n  def f():\n    continue\n  end\nend", (3, 5), "outside of a loop"),
        ("5", (1, 1), "must do something"),
        ("a = 1 a", (1, 7), "must do something"),
        ("textmsg(1) = 2", (1, 1), "can be assigned"),
        ("s = struct(1)", (1, 5), "named values"),
    ],
)
def test_wrong_calls_and_statements_are_refused(text: str, place: tuple[int, int], words: str) -> None:
    line, column, why = refusal(text)
    assert (line, column) == place
    assert words in why


def test_a_builtin_takes_its_parameters_from_the_signature() -> None:
    def str_sub(src: object, index: object, len_: object = 5) -> None: ...

    builtin = Builtin.of(str_sub)
    assert [(p.name, p.default) for p in builtin.parameters][2] == ("len", 5)
    assert not builtin.blocking
    with pytest.raises(TypeError, match="plain parameters"):
        Builtin.of(lambda *values: values)
