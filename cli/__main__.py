"""The command line: `dsl-assembly`, and `python -m cli` where this project starts a process of its own."""

from typing import Annotated

import typer

from cli.lazy import Entry, LazyGroup
from service.program import PROGRAM

CELL = "Cell"
PROCESSES = "Processes and arms"
POLICIES = "Policies"
PROJECT = "Configuration and measurements"

COMMANDS = {
    "serve": Entry("cli.serve:serve", "Serve one cell: API and page, control process, simulator.", CELL),
    "demo": Entry("cli.demo:demo", "Start the cell, insert one peg, stay up until Ctrl-C.", CELL),
    "start": Entry("cli.operate:start", "Ask a running cell for one insertion.", CELL),
    "stop": Entry("cli.stop:stop", "Stop whatever moves, now.", CELL),
    "status": Entry("cli.operate:status", "Say what is measured now.", CELL),
    "reset": Entry("cli.operate:reset", "Acknowledge the latched fault after looking at the cell.", CELL),
    "runs": Entry("cli.operate:runs", "List the runs, newest first.", CELL),
    "watch": Entry("cli.watch:watch", "Show the cell live in the terminal until Ctrl-C.", CELL),
    "control": Entry(
        "service.commands.control:control",
        "Run the control process of a cell until SIGTERM, Ctrl-C or the end of the terminal.",
        PROCESSES,
    ),
    "sim": Entry(
        "sim_backend.commands:app", "Serve a simulated cell, or an emulated UR controller, or draw it.", PROCESSES
    ),
    "ur": Entry("service.commands.ur:app", "Operate a Universal Robots arm.", PROCESSES),
    "policy": Entry("cli.policy:app", "Look into a policy file, or ask whether it fits a cell.", POLICIES),
    "train": Entry("training.commands.train:train", "Train an experiment, once for each seed.", POLICIES),
    "export": Entry("training.commands.export:export", "Write a trained policy.", POLICIES),
    "evaluate": Entry(
        "training.commands.evaluate:evaluate", "Play fresh seeds with the deterministic policy.", POLICIES
    ),
    "report": Entry(
        "training.commands.report:report", "Write the report of all results and the models' cards.", POLICIES
    ),
    "reproduce": Entry("training.commands.reproduce:reproduce", "Play all of the report's episodes again.", POLICIES),
    "carry": Entry(
        "training.commands.carry:carry",
        "Show that REVISION and the present sources play the same, bit for bit.",
        POLICIES,
    ),
    "baseline": Entry("training.commands.baseline:baseline", "Write a scripted policy.", POLICIES),
    "gallery": Entry("training.commands.gallery:gallery", "Draw each part's insertion.", POLICIES),
    "config": Entry("cli.config:app", "Write, check and describe the configuration of a cell.", PROJECT),
    "openapi": Entry("cli.openapi:openapi", "Print the OpenAPI document of the HTTP interface.", PROJECT),
    "bench": Entry("benchmarks.commands:bench", "Measure this project on this machine.", PROJECT),
    "bench-compare": Entry("benchmarks.commands:bench_compare", "Measure two commits by turns.", PROJECT),
}


class Commands(LazyGroup):
    """All commands of the project."""

    entries = COMMANDS


app = typer.Typer(cls=Commands, add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)


def _print_version(wanted: bool) -> None:
    if wanted:
        from api.version import installed_version
        from service.policy import compiled as compiled_step
        from sim_backend.world import compiled as compiled_tick

        typer.echo(f"{PROGRAM} {installed_version()}")
        typer.echo(compiled_step.describe())
        typer.echo(compiled_tick.describe())
        raise typer.Exit


@app.callback()
def main(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Run a learned peg insertion on a robot cell, under a dynamic safety lock and a force ceiling.

    Process protection beside the robot's certified safety functions, which it does not replace.
    """


if __name__ == "__main__":
    app(prog_name=PROGRAM)
