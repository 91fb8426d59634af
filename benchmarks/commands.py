"""`bench`: run all benchmarks or some, print the tables, save them."""

import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Protocol, cast

import typer
from rich.console import Console

from benchmarks.harness import machine, report
from benchmarks.harness.result import Result, UnavailableError
from wire.exits import Exit

BENCHMARKS = (
    *("tick", "stop_latency", "round_trip", "lockstep", "lateness", "throughput", "training_share", "peers"),
    *("rtde", "emulator", "ur_client", "ur_stop", "ur_ceiling", "ur_silence", "contact_loop", "sensor_lies"),
    "force_overshoot",
)
FOLDER = Path("benchmarks/results")


class Benchmark(Protocol):
    """Interface of a module in `benchmarks.cases`, which holds one measurement."""

    def measure(self, scale: float, **given: Any) -> Result:
        """Measure; `scale` multiplies the number of repetitions, `given` holds options of this benchmark only."""
        ...


def bench(
    names: Annotated[
        list[str] | None, typer.Argument(help=f"Benchmarks to run: {', '.join(BENCHMARKS)}; all by default.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="A tenth of the repetitions; nothing is saved.")] = False,
    out: Annotated[Path, typer.Option(help="Folder for latest.md and latest.json.")] = FOLDER,
    peers_python: Annotated[
        Path | None, typer.Option(exists=True, dir_okay=False, help="Python with robosuite, Gymnasium-Robotics.")
    ] = None,
) -> None:
    """Measure this project on this machine, print the tables and save them."""
    console = Console()
    wanted = names or list(BENCHMARKS)
    if unknown := sorted(set(wanted) - set(BENCHMARKS)):
        console.print(f"no benchmark {', '.join(unknown)}; there are {', '.join(BENCHMARKS)}")
        raise typer.Exit(Exit.USAGE)
    taken = machine.conditions()
    console.print(", ".join(f"{name} {value}" for name, value in taken.items()), highlight=False)
    given = {"peers": {"python": peers_python}}
    results: dict[str, Result] = {}
    written: Sequence[Path] = ()
    failed = False
    for name in wanted:
        load = machine.load()
        with console.status(f"{name} …"):
            results[name], ran = _measure(console, name, 0.1 if quick else 1.0, given.get(name, {}))
        failed |= not ran
        taken[f"load at {name}"] = load
        report.show(console, name, results[name])
        if not quick:  # after each benchmark, so that an interrupted run keeps its results
            written = report.save(out, taken, results)
    for path in written:
        console.print(f"wrote {path}", highlight=False)
    raise typer.Exit(Exit.FAILED if failed else 0)


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
