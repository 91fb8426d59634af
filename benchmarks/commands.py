"""`bench` and `bench-compare`: measure this checkout, or two commits by turns."""

import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Protocol, cast

import typer
from rich.console import Console

from benchmarks import comparison
from benchmarks.harness import machine, report
from benchmarks.harness.result import Result, UnavailableError
from wire.exits import Exit

SHORT = {
    "inference": 0.1,
    "tick": 0.2,
    "round_trip": 0.5,
    "lockstep": 0.2,
    "stop_latency": 0.05,
    "deployed_step": 0.1,
    "lateness": 0.1,
}
"""Benchmarks that `--short` runs, with the scale at which all of them together take less than five minutes."""
BENCHMARKS = (
    *SHORT,
    *("whole_cell", "throughput", "training_share", "peers"),
    *("rtde", "emulator", "ur_client", "ur_stop", "ur_ceiling", "ur_silence"),
    *("contact_loop", "sensor_lies", "force_overshoot"),
)
QUICK = 0.1
FOLDER = Path("benchmarks/results")
Names = Annotated[list[str] | None, typer.Argument(help=f"Benchmarks to run: {', '.join(BENCHMARKS)}.")]


class Benchmark(Protocol):
    """Interface of a module in `benchmarks.cases`, which holds one measurement."""

    def measure(self, scale: float, **given: Any) -> Result:
        """Measure; `scale` multiplies the number of repetitions, `given` holds options of this benchmark only."""
        ...


def bench(
    names: Names = None,
    short: Annotated[bool, typer.Option("--short", help="Those that take five minutes together.")] = False,
    quick: Annotated[bool, typer.Option("--quick", help="A tenth of the repetitions; nothing is saved.")] = False,
    out: Annotated[Path, typer.Option(help="Folder for latest.md and latest.json.")] = FOLDER,
    peers_python: Annotated[
        Path | None, typer.Option(exists=True, dir_okay=False, help="Python with robosuite, Gymnasium-Robotics.")
    ] = None,
) -> None:
    """Measure this project on this machine, print the tables with their limits, and save them.

    Without names all benchmarks run, or those of `--short`.
    """
    console = Console()
    wanted = _checked(console, names or list(SHORT if short else BENCHMARKS))
    taken = machine.conditions()
    console.print(", ".join(f"{name} {value}" for name, value in taken.items()), highlight=False)
    given = {"peers": {"python": peers_python}}
    results: dict[str, Result] = {}
    written: Sequence[Path] = ()
    failed = False
    for name in wanted:
        load = machine.load()
        scale = SHORT.get(name, QUICK) if short else QUICK if quick else 1.0
        with console.status(f"{name} …"):
            results[name], ran = _measure(console, name, scale, given.get(name, {}))
        failed |= not ran
        taken[f"load at {name}"] = load
        report.show(console, name, results[name])
        if not quick:  # after each benchmark, so that an interrupted run keeps its results
            written = report.save(out, taken, results)
    for path in written:
        console.print(f"wrote {path}", highlight=False)
    raise typer.Exit(Exit.FAILED if failed else 0)


def bench_compare(
    before: Annotated[str, typer.Argument(help="Commit to compare with.")],
    after: Annotated[str, typer.Argument(help="Commit that is judged.")],
    names: Names = None,
    turns: Annotated[int, typer.Option(min=2, help="Measurements of each commit, by turns.")] = 6,
) -> None:
    """Measure two commits by turns (A B A B …) with the benchmarks of this checkout, and compare their figures.

    Without names the benchmarks of `bench --short` run.
    """
    console = Console()
    wanted = _checked(console, names or list(SHORT))
    try:
        changes = comparison.compare((before, after), wanted, turns, lambda text: console.print(text, highlight=False))
    except comparison.CommitError as error:
        console.print(str(error), highlight=False)
        raise typer.Exit(Exit.USAGE) from error
    console.print(comparison.table(changes, turns))
    raise typer.Exit(0 if changes else Exit.FAILED)


def _checked(console: Console, wanted: list[str]) -> list[str]:
    if unknown := sorted(set(wanted) - set(BENCHMARKS)):
        console.print(f"no benchmark {', '.join(unknown)}; there are {', '.join(BENCHMARKS)}")
        raise typer.Exit(Exit.USAGE)
    return wanted


def _measure(console: Console, name: str, scale: float, given: Mapping[str, Any]) -> tuple[Result, bool]:
    """Return the result, and True if the benchmark raised no error of its own."""
    try:
        module = cast("Benchmark", importlib.import_module(f"benchmarks.cases.{name}"))
        return module.measure(scale, **given), True
    except UnavailableError as error:
        return Result(question="", missing=str(error)), True
    except Exception as error:  # a failure must not cost the results of the others
        console.print_exception()
        return Result(question="", missing=f"failed: {type(error).__name__}: {error}"), False
