"""Threads, ticks and ends of programs."""

import pytest

from sim_backend.ur_controller.script import State
from tests.sim_backend.ur_controller.script.runs import Run, error


def test_every_thread_runs_once_in_each_tick() -> None:
    text = """
    thread other():
      while True:
        out("other")
        sync()
      end
    end
    run other()
    while True:
      out("main")
      sync()
    end
    """
    run = Run(text).step(3)
    assert run.printed == ["main", "other"] * 3
    assert run.ticks == [1, 1, 2, 2, 3, 3]
    assert run.threads == ["unnamed", "other"] * 3


def test_sleep_waits_for_whole_ticks() -> None:
    run = Run("out(1) sleep(0.002) out(2) sleep(0.01) out(3) sleep(0.0031) out(4) sleep(0) out(5)").to_end()
    assert run.ticks == [1, 2, 7, 9, 9]


def test_join_waits_for_the_end_of_a_thread() -> None:
    text = """
    thread t():
      move(4)
      out("thread")
    end
    h = run t()
    join h
    out("joined")
    join h
    join 0
    out("again")
    """
    run = Run(text).to_end()
    assert run.printed == ["thread", "joined", "again"]
    assert run.ticks[0] == 5
    assert run.ticks[1] == run.ticks[2] <= 6


def test_kill_ends_a_thread_where_it_waits_and_closes_what_it_has_begun() -> None:
    text = """
    thread t():
      move(100, "long")
      out("never")
    end
    h = run t()
    sync()
    sync()
    kill h
    kill h
    kill 0
    kill 99
    out(h)
    move(200)
    """
    run = Run(text).step(5)
    assert run.printed == [1]
    assert run.closed == ["long"]
    assert run.to_end().printed == [1]


def test_kill_ends_the_threads_that_a_thread_has_run() -> None:
    text = """
    n = 0
    thread child():
      while True:
        n = n + 1
        sync()
      end
    end
    thread parent():
      run child()
      sleep(10)
    end
    h = run parent()
    sleep(0.006)
    kill h
    seen = n
    sleep(0.006)
    out(n - seen)
    out(seen > 0)
    """
    assert Run(text).to_end().printed == [0, True]


def test_a_thread_may_kill_itself() -> None:
    text = """
    h = 0
    thread t():
      out("before")
      kill h
      out("after")
    end
    h = run t()
    sleep(0.01)
    out("main")
    """
    assert Run(text).to_end().printed == ["before", "main"]


def test_the_end_of_the_main_program_is_the_end_of_all() -> None:
    run = Run('thread t(): move(100, "thread") end run t() sync()').to_end()
    assert run.closed == ["thread"]


def test_halt_ends_everything_from_inside_a_thread() -> None:
    run = Run('thread t(): sync() halt end run t() move(100, "main") out("never")').to_end()
    assert run.printed == []
    assert run.closed == ["main"]
    assert run.tick == 2


def test_an_error_in_a_thread_names_it_and_ends_everything() -> None:
    run = Run('def prog():\n  thread bad():\n    x = [1]\n    out(x[5])\n  end\n  run bad()\n  move(100, "main")\nend')
    run.step()
    failure = run.execution.error
    assert run.execution.state is State.FAILED
    assert failure is not None
    assert (failure.line, failure.column, failure.thread) == (4, 9, "bad")
    assert str(failure) == "line 4, column 9, in bad: Index 5 is out of range: the list has 1 elements"
    assert run.closed == ["main"]


def test_an_error_is_placed_at_the_call_that_failed() -> None:
    text = "def f(x):\n  y = 1\n  return 2 * sqrt(x)\nend\nout(f(4))\nout(f(-1))"
    assert error(text) == (3, 14, "sqrt is not defined for -1.0")


def test_a_mistake_in_a_builtin_ends_the_program_only() -> None:
    assert error("fault()") == (1, 1, "KeyError: 'mistake'")


def test_a_loop_that_takes_no_time_leaves_time_to_others() -> None:
    text = """
    n = 0
    thread busy():
      while True:
        n = n + 1
      end
    end
    run busy()
    while True:
      out(n)
      sync()
    end
    """
    run = Run(text).step(4)
    assert run.ticks == [1, 2, 3, 4]
    assert run.printed[0] == 0
    steps = [b - a for a, b in zip(run.printed[1:], run.printed[2:], strict=False)]
    assert all(100 < step < 10_000 for step in steps)


def test_work_in_a_tick_is_bounded_by_the_limit_whatever_it_is_spent_on() -> None:
    def count(limit: int) -> int:
        run = Run("n = 0\nwhile True:\n  n = n + 1\n  out(n)\nend", step_limit=limit).step(2)
        return len(run.printed)

    assert 100 < count(10_000) < 1000
    assert count(20_000) == pytest.approx(2 * count(10_000), rel=0.05)


def test_branches_count_only_when_they_are_taken_and_threads_only_with_what_they_do() -> None:
    branches = "".join(f"elif x == {i}:\n  {'out(sin(1)) ' * 10}\n" for i in range(1, 70))
    text = f"""
    thread idle():
      while True:
        sync()
      end
    end
    i = 0
    while i < 20:
      run idle()
      i = i + 1
    end
    def choose(x):
      if x == 0:
        return
      {branches}
      end
    end
    while True:
      sync()
      out("start")
      choose(40)
      out("end")
    end
    """
    run = Run(text).step(5)
    starts = [tick for tick, what in zip(run.ticks, run.printed, strict=True) if what == "start"]
    ends = [tick for tick, what in zip(run.ticks, run.printed, strict=True) if what == "end"]
    assert starts == ends == [2, 3, 4, 5]


def test_recursion_without_loops_is_bounded_in_work_and_in_depth() -> None:
    run = Run("def f(n):\n  if n > 0:\n    return f(n - 1) + f(n - 1)\n  end\n  return 1\nend\nout(f(40))").step(3)
    assert run.execution.state is State.RUNNING
    assert "deep" in error("def f(n):\n  return f(n + 1)\nend\nf(0)")[2]


def test_chains_of_functions_are_bounded_in_work() -> None:
    functions = "".join(f"def f{i}():\n  return f{i + 1}() + f{i + 1}()\nend\n" for i in range(40))
    run = Run(functions + "def f40():\n  return 1\nend\nout(f0())").step(3)
    assert run.execution.state is State.RUNNING


def test_a_critical_section_is_not_interrupted_when_the_budget_ends() -> None:
    text = """
    a = 0
    b = 0
    thread writer():
      while True:
        enter_critical
        a = a + 1
        i = 0
        while i < 3000:
          i = i + 1
        end
        b = b + 1
        exit_critical
        sync()
      end
    end
    run writer()
    while True:
      out(a - b)
      sync()
    end
    """
    run = Run(text).step(30)
    assert len(run.printed) > 5
    assert set(run.printed) == {0}


def test_a_thread_that_waits_inside_of_a_critical_section_lets_others_into_theirs() -> None:
    text = """
    thread mover():
      enter_critical
      move(50)
      exit_critical
      out("moved")
    end
    run mover()
    sync()
    enter_critical
    out("main")
    exit_critical
    move(100)
    """
    run = Run(text).to_end()
    assert run.printed == ["main", "moved"]
    assert run.ticks[0] == 2


def test_a_program_can_be_killed_from_outside_and_by_its_own_builtin() -> None:
    run = Run('thread t(): move(9, "thread") end run t() move(100, "main")').step(2)
    run.execution.kill()
    assert run.execution.state is State.FINISHED
    assert sorted(run.closed) == ["main", "thread"]
    run.step()
    own = Run('thread t(): move(9, "thread") end run t() sync() stop() move(9, "main") out("never")').step(5)
    assert own.execution.state is State.FINISHED
    assert own.execution.current_thread is None
    assert own.printed == []
    assert sorted(own.closed) == ["main", "thread"]


def test_threads_are_bounded_in_number() -> None:
    assert "threads" in error("thread t(): sleep(1) end\nwhile True:\n  run t()\nend")[2]


def test_threads_that_end_make_room_for_others() -> None:
    text = """
    n = 0
    thread t():
      n = n + 1
    end
    i = 0
    while i < 100:
      join run t()
      i = i + 1
    end
    out(n)
    """
    assert Run(text).to_end().printed == [100]


def test_a_compiled_script_runs_afresh_each_time() -> None:
    run = Run("a = 0\na = a + 1\nout(a)")
    first = run.to_end().printed.copy()
    assert first == Run("a = 0\na = a + 1\nout(a)").to_end().printed == [1]
