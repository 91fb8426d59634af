"""Meaning of scripts: by UR's script manual where it says so, else by what clients in use need."""

import math

import pytest

from sim_backend.ur_controller.script import CompileError, Pose, Value
from tests.sim_backend.ur_controller.script.runs import Run, error, printed, value


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("1 + 2 * 3", 7),
        ("(1 + 2) * 3", 9),
        ("10 - 4 - 3", 3),
        ("7 / 2", 3.5),
        ("7 % 4", 3),
        ("-7 % 4", -3),
        ("2 * 5 % 3", 1),
        ("-2 * -3", 6),
        ("- 3 + 1", -2),
        ("+4", 4),
        ("1e-3", 0.001),
        ("2.5E2", 250.0),
        (".5 + 5.", 5.5),
        ("0x1F", 31),
        ("0xFFFFFFFF", -1),
        ("True", True),
        ("1 == 1.0", True),
        ("1 != 2", True),
        ("2 <= 2", True),
        ("3 < 2", False),
        ("True and not False", True),
        ("False or 1 < 2", True),
        ("True xor True", False),
        ("True xor False", True),
        ("not 1 == 2", True),
        ("False and True or True", True),
        ("True or True and False", True),
        ('"a" + "b"', "ab"),
        ('"a" == "a"', True),
        ('"# no comment <br/> {x}"', "# no comment <br/> {x}"),
        ("[1, 2] == [1, 2.0]", True),
        ("p[1,2,3,4,5,6] == [1,2,3,4,5,6]", False),
        ("[1,2,3] * [10,20,30]", [10, 40, 90]),
        ("[10,20,30] / [1,2,4]", [10, 10, 7.5]),
        ("[1,2,3] + [10,20,30]", [11, 22, 33]),
        ("[10,20,30] - [1,2,3]", [9, 18, 27]),
        ("[10,21,32] % [3,4,5]", [1, 1, 2]),
        ("[1,2,3] * 5", [5, 10, 15]),
        ("10 / [10,20,40]", [1, 0.5, 0.25]),
        ("5 * [[1,2],[3,4]]", [[5, 10], [15, 20]]),
        ("-[1, -2]", [-1, 2]),
        ("[[1,2],[3,4],[5,6]] * [[10,20,30],[40,50,60]]", [[90, 120, 150], [190, 260, 330], [290, 400, 510]]),
        ("[[1,2],[3,4],[5,6]] * [10,20]", [50, 110, 170]),
        ("[[1,2],[3,4]] + [[1,1],[1,1]]", [[2, 3], [4, 5]]),
        ("[]", []),
        ("[5, 6, 7][1]", 6),
        ("[[1,2],[3,4],[5,6]][2,1]", 6),
        ("[[1,2],[3,4]][1][0]", 3),
        ("p[1,2,3,4,5,6][3]", 4),
        ("struct(a = 1, b = [2, 3]).b[1]", 3),
        ("struct(x = 4). x", 4),
        ("2147483647 + 1", 2147483648.0),
        ("4 / 2", 2),
    ],
)
def test_expressions(expression: str, expected: Value) -> None:
    assert value(expression) == expected


def test_a_pose_stays_a_pose_and_a_list_a_list() -> None:
    assert type(value("p[1,2,3,4,5,6]")) is Pose
    assert type(value("p[1,2,3,4,5,6] * 2")) is Pose
    assert type(value("[1,2,3,4,5,6] * 2")) is list
    assert value("p[1,2,3,4,5,6] * 2") == Pose([2, 4, 6, 8, 10, 12])


def test_the_right_side_of_and_and_or_is_left_out_when_the_left_decides() -> None:
    text = """
    def noisy():
      out("called")
      return True
    end
    a = False and noisy()
    b = True or noisy()
    out(a == False and b)
    """
    assert printed(text) == [True]


def test_numbers_are_conditions_and_strings_are_none() -> None:
    assert printed("if 0.5: out(1) end if 0: out(2) end") == [1]
    assert error('if "x":\nend')[2].startswith("Type error")


def test_lists_are_values() -> None:
    text = """
    a = [1, 2, 3]
    b = a
    b[0] = 9
    def change(list):
      list[1] = 8
      return list
    end
    c = change(a)
    m = [[1, 2], [3, 4]]
    row = m[0]
    m[0, 1] = 7
    row[0] = 5
    s = struct(q = a, n = 0)
    t = s
    t.q[2] = 6
    t.n = 1
    out(a)
    out(b)
    out(c)
    out(m)
    out(s.q)
    out(t.q)
    """
    assert printed(text) == [[1, 2, 3], [9, 2, 3], [1, 8, 3], [[1, 7], [3, 4]], [1, 2, 3], [1, 2, 6]]


def test_p_is_a_name_like_any_other() -> None:
    text = """
    def scale(p, factor):
      p[0] = p[0] * factor
      return p
    end
    p = scale(p[1, 2, 3, 4, 5, 6], 10)
    out(p)
    out(p[p[2] - 1])
    q = [7, 8, 9, 10, 11, 12]
    out(p[q[0], q[1], q[2], q[3], q[4], q[5]])
    """
    assert printed(text) == [Pose([10, 2, 3, 4, 5, 6]), 3, Pose([7, 8, 9, 10, 11, 12])]


def test_words_of_other_languages_are_names() -> None:
    assert printed("async = 1 type = 2 time = 3 lambda = 4 None = 5 out(async + type + time + lambda + None)") == [15]


def test_statements_end_where_they_cannot_go_on() -> None:
    text = """
    global a = # the value comes
1    global b = # here
2 out(a
      + b) if a == 1 or
      b == 5: out([1,
        2]) end
    """
    assert printed(text) == [3, [1, 2]]


def test_only_a_bare_return_depends_on_its_line() -> None:
    text = """
    def early(x):
      if x:
        return  # and no more
      end
      out("late")
      return
        out("dead")
    end
    early(True)
    early(False)
    """
    assert printed(text) == ["late"]


def test_labels_of_the_program_tree_are_passed_over() -> None:
    text = """
    def Program():
      global _hidden_verificationVariable=0
      step_count_1f=0.0
      thread Step_Counter_Thread_1f():
        while (True):
          step_count_1f = step_count_1f + 1.0
          sync()
        end
      end
      run Step_Counter_Thread_1f()
      $ 1 "BeforeStart"
      global Waypoint_1_p=p[-0.1, .2, 0.3, 0.0, 3.1416, 0.0]
      $ 2 "Robot Program"
      while (True):
        $ 3 "Wait: 0.01" "noBreak"
        sleep(0.01)
        $ 4 "If (a = 1)"
        if (step_count_1f > 2):
          out(str_cat("steps: ", step_count_1f))
          halt
        end
      end
    end
    """
    assert printed(text) == ["steps: 5"]


@pytest.mark.parametrize(
    ("x", "expected"),
    [(1, "one"), (2, "two"), (3, "three"), (9, "else")],
)
def test_the_first_branch_that_holds_is_taken(x: int, expected: str) -> None:
    text = f"""
    x = {x}
    if x == 1:
      out("one")
    elif x == 2:
      out("two")
    elif x == 3:
      out("three")
    else:
      out("else")
    end
    """
    assert printed(text) == [expected]


def test_loops_break_and_continue() -> None:
    text = """
    i = 0
    while True:
      i = i + 1
      if i == 2:
        continue
      elif i > 4:
        break
      end
      j = 0
      while j < 2:
        j = j + 1
        if j == 1:
          continue
        end
        out([i, j])
      end
    end
    """
    assert printed(text) == [[1, 2], [3, 2], [4, 2]]


def test_variables_of_the_first_level_are_global() -> None:
    text = """
    def myProg():
      a = 0
      local c = 5
      def myFun():
        a = a + 1
        b = 10
        c = 6
        local d = a
        return d
      end
      out(myFun())
      out(a)
      out(c)
    end
    """
    assert printed(text) == [1, 1, 6]


def test_a_local_masks_the_global_and_is_not_seen_further_in() -> None:
    text = """
    def myProg():
      global a = 0
      def myFun():
        local a = 1
        def myFun2():
          a = 2
        end
        myFun2()
        out(a)
      end
      myFun()
      out(a)
    end
    """
    assert printed(text) == [1, 2]


def test_a_global_may_be_born_in_a_function_and_stand_behind_its_use() -> None:
    text = """
    def set():
      global made = 3
    end
    def show():
      out(made)
      out(late)
    end
    set()
    late = 4
    show()
    """
    assert printed(text) == [3, 4]


def test_parameters_have_names_and_defaults() -> None:
    text = """
    base = 10
    def f(a, b = base + 1, c = [1, 2]):
      return [a, b, c[0]]
    end
    out(f(1))
    out(f(1, 2))
    out(f(1, c = [9]))
    base = 20
    out(f(c = [5], a = 3))
    """
    assert printed(text) == [[1, 11, 1], [1, 2, 1], [1, 11, 9], [3, 21, 5]]


def test_functions_call_each_other_before_they_are_declared_and_inside_of_others() -> None:
    text = """
    def even(n):
      if n == 0:
        return True
      end
      return odd(n - 1)
    end
    def odd(n):
      if n == 0:
        return False
      end
      return even(n - 1)
    end
    def outer():
      def inner():
        return "inner"
      end
      return inner()
    end
    def inner():
      return "outside"
    end
    out(even(20))
    out(outer())
    out(inner())
    """
    assert printed(text) == [True, "inner", "outside"]


def test_a_function_of_the_script_hides_a_builtin_and_a_variable_does_not() -> None:
    assert printed("def sin(x): return 5 end length = 2 out(sin(0)) out(length([1, 2, 3]))") == [5, 3]


def test_a_field_may_have_the_name_of_a_keyword() -> None:
    with pytest.raises(CompileError):
        value("struct(sec = 1)")
    assert error("s = struct(a = 1)\nout(s.sec)") == (2, 6, "The struct has no field sec, it has a")


def test_blocking_functions_have_values_and_take_time() -> None:
    run = Run("x = move(2) + move(ticks = 1)\nout(x)").to_end()
    assert run.printed == [30]
    assert run.ticks == [4]


def test_lists_of_variable_length() -> None:
    text = """
    a = make_list(2, 1.5, 10)
    a.append(7)
    a.insert(0, 3)
    def last(list):
      return list.pop()
    end
    out(last(a))
    out(a.pop())
    out(a)
    out(a.length() + [1, 2].length())
    a.clear()
    out(a)
    """
    assert printed(text) == [7, 7, [3, 1.5, 1.5], 5, []]


@pytest.mark.parametrize(
    "expression",
    [
        "1 + True",
        '1 + "a"',
        '"a" * 1000',
        "[1] * [1, 2]",
        '[1] + ["a"]',
        "[[1,2],[3,4]] * [1,2,3]",
        "[[1,2],[3,4]] * [[1,2,3]]",
        "[1, 2][2]",
        "[1, 2][-1]",
        "[1, 2][0.5]",
        "5[0]",
        '"abc"[0]',
        "struct(a = 1).b",
        "[1].a",
        "[1].reverse()",
        "p[1,2,3,4,5,6].pop()",
        "[].pop()",
        '-"a"',
        '"a" < "b"',
        "[1] < [2]",
        "1 / 0",
        "1.0 % 0",
        "[1] / 0",
        'not "a"',
        'p[1,2,3,4,5,"a"]',
        "[[[[[1]]]]]",
        "floor(1e20) + 1 / 0.0",
    ],
)
def test_wrong_types_and_ranges_are_run_time_errors(expression: str) -> None:
    line, column, text = error(f"def f():\n  out(0)\n  x = {expression}\nend")
    assert line == 3
    assert column >= 5
    assert text


def test_integers_do_not_grow_without_bound() -> None:
    run = Run("x = 2 while True: x = x * x sync() end").step(200)
    assert run.execution.error is None
    assert value("(65536 * 65536) * 1.0") == 2.0**32
    assert math.isinf(value("1e300 * 1e300"))


def test_a_variable_that_has_no_value_yet_is_named() -> None:
    assert error("if False: x = 1 end\nout(x)") == (2, 5, "Variable x is used before it has a value")
    text = "def f(c):\n  if c:\n    y = 1\n  end\n  return y\nend\nout(f(False))"
    assert error(text) == (5, 10, "Variable y is used before it has a value")


def test_a_function_without_a_value_gives_none_to_use() -> None:
    text = error("def f():\nend\nx = f() + 1")[2]
    assert text == "Type error: + cannot be applied to a no value and a int"
