"""Command line of training: `python -m training train`, `export` and `evaluate`."""

import json
import math
import shutil
import subprocess
import time
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, NoReturn, get_args

import typer

from service.policy.contract import EvaluationFigure
from service.policy.model import Policy, PolicyError
from service.policy.observation import Mode
from service.safety import dsl
from sim_backend.protocol.task import Conditions, Part
from training import design, evaluate
from training.episodes import TaskSource
from training.recipe import Recipe
from training.reward import RewardName

EXIT_USAGE = 2
RUNS = Path("var/training")
MOST_CELLS = 100
_RECIPE, _TASKS = Recipe(), TaskSource()
_RANGE_MM = _TASKS.clearance_m[0] * 1e3, _TASKS.clearance_m[1] * 1e3

app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False)


@app.command()
def train(
    name: Annotated[str, typer.Argument(help="Of the run; its files go to var/training/NAME.")],
    steps: Annotated[int, typer.Option(min=1, help="Environment steps in all.")] = _RECIPE.steps,
    start_from: Annotated[Path | None, typer.Option("--from", help="Model to continue: a checkpoint.zip.")] = None,
    mode: Annotated[Mode, typer.Option(help="What the policy observes.")] = "VFTM",
    lock: Annotated[str, typer.Option(help="paper, peck, sliding or off; VM has no other.")] = "",
    part: Annotated[Part, typer.Option(help="Peg and hole.")] = _TASKS.part,
    clearance: Annotated[tuple[float, float], typer.Option(help="Range trained on, mm per face.")] = _RANGE_MM,
    conditions: Annotated[Conditions, typer.Option(help="Distributions of an episode.")] = _TASKS.conditions,
    randomise_plant: Annotated[
        bool, typer.Option(help="Friction, stiffness, delay and mass vary.")
    ] = _TASKS.randomise_plant,
    reward: Annotated[RewardName, typer.Option(help="Which reward.")] = _RECIPE.reward,
    hidden: Annotated[str, typer.Option(help="Layers of actor and critic.")] = ",".join(map(str, _RECIPE.hidden)),
    cells: Annotated[
        int, typer.Option(min=1, help="Stepped together, over all workers; rounded down to a multiple of these.")
    ] = _RECIPE.cells,
    workers: Annotated[int, typer.Option(min=1, help="Processes; one per core is fastest.")] = _RECIPE.workers,
    threads: Annotated[int, typer.Option(min=0, help="Of the physics, per worker; 0: one per core.")] = _RECIPE.threads,
    torch_threads: Annotated[
        int, typer.Option(min=0, help="Of the update; 0: torch's choice.")
    ] = _RECIPE.torch_threads,
    rollout: Annotated[int, typer.Option(min=1, help="Steps per cell between two updates.")] = _RECIPE.rollout,
    batch: Annotated[int, typer.Option(min=2, help="Of the update.")] = _RECIPE.batch,
    epochs: Annotated[int, typer.Option(min=1, help="Of the update.")] = _RECIPE.epochs,
    learning_rate: Annotated[float, typer.Option(help="At the start; falls to a tenth.")] = _RECIPE.learning_rate,
    seed: Annotated[int, typer.Option(min=0, help="Of network, exploration and tasks.")] = _RECIPE.seed,
    device: Annotated[str, typer.Option(help="Of the network: cpu or cuda.")] = _RECIPE.device,
    minutes: Annotated[float, typer.Option(help="End after this time with what there is.")] = math.inf,
) -> None:
    """Train a policy with PPO. Ctrl-C leaves a checkpoint that `--from` continues."""
    try:
        from training.learn import learn
    except ImportError as error:
        _fail(f"training needs the extra `training` ({error}): make setup-training")
    directory = RUNS / name
    if (directory / "final.zip").exists():
        _fail(f"{directory} holds a finished run: choose another name")
    if cells < workers:
        _fail(f"{cells} cells are too few for {workers} workers: each wants one at least")
    if cells % workers:
        asked, cells = cells, cells - cells % workers
        typer.echo(f"{asked} cells do not divide evenly over {workers} workers: training with {cells}", err=True)
    if lock and lock not in get_args(dsl.Mode):
        _fail(f"--lock must be one of {', '.join(get_args(dsl.Mode))}, not {lock!r}")
    span = clearance[0] * 1e-3, clearance[1] * 1e-3
    chosen: Any = lock or None
    try:
        contract = design.contract_for(mode, chosen, part, name=name)
        tasks = TaskSource(part, span, conditions, randomise_plant)
        recipe = Recipe(
            steps=steps,
            cells=cells,
            workers=workers,
            rollout=rollout,
            hidden=tuple(int(width) for width in hidden.split(",")),
            learning_rate=learning_rate,
            batch=batch,
            epochs=epochs,
            reward=reward,
            threads=threads,
            torch_threads=torch_threads,
            seed=seed,
            device=device,
        )
        for value in span:
            evaluate.Task(0, part, value, conditions).check()
    except ValueError as error:
        _fail(str(error))
    directory.mkdir(parents=True, exist_ok=True)
    document = {
        "algorithm": f"PPO of stable-baselines3 {version('stable-baselines3')}",
        "recipe": asdict(recipe),
        "tasks": asdict(tasks),
        "continues": None if start_from is None else str(start_from),
        "commit": _commit(),
        "began": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }
    (directory / "recipe.json").write_text(json.dumps(document, indent=2) + "\n")
    (directory / "contract.json").write_text(contract.model_dump_json(indent=2) + "\n")
    learn(contract, tasks, recipe, directory, start_from, minutes * 60)
    typer.echo(f"wrote {directory / 'final.zip'}; next: python -m training export {directory / 'final.zip'} OUT.onnx")


@app.command()
def export(
    model: Annotated[Path, typer.Argument(help="A model that `train` saved.", exists=True, dir_okay=False)],
    out: Annotated[Path, typer.Argument(help="ONNX file to write.")],
    name: Annotated[str, typer.Option(help="Of the policy; default: that of the training.")] = "",
) -> None:
    """Write a trained policy as the file that a cell loads: network, normalisation and contract in one."""
    try:
        from stable_baselines3 import PPO

        from training import export as exporting
    except ImportError as error:
        _fail(f"exporting needs the extra `training` ({error}): make setup-training")
    trained = PPO.load(model, device="cpu")
    contract = exporting.contract_of(trained)
    recipe = model.parent / "recipe.json"
    provenance: dict[str, Any] = json.loads(recipe.read_text()) if recipe.is_file() else {}
    provenance["steps"] = trained.num_timesteps
    policy = exporting.export(
        trained, contract.model_copy(update={"name": name or contract.name, "provenance": provenance}), out
    )
    typer.echo(f"wrote {out}: {policy.contract.name}, {out.stat().st_size} bytes, SHA-256 {policy.sha256}")


@app.command("evaluate")
def evaluate_command(
    model: Annotated[Path, typer.Argument(help="ONNX file of the policy.")],
    clearance: Annotated[list[float] | None, typer.Option(help="Per face, mm; may be repeated.")] = None,
    episodes: Annotated[int, typer.Option(min=1, help="Per clearance.")] = 500,
    conditions: Annotated[Conditions, typer.Option(help="Distributions of an episode.")] = "standard",
    first_seed: Annotated[int, typer.Option(min=0, help="Seeds count up from here.")] = evaluate.FIRST_TEST_SEED,
    threads: Annotated[int, typer.Option(min=0, help="Of the physics; 0: one per core.")] = 0,
    force_ceiling: Annotated[float, typer.Option(help="N; the episode ends there.")] = 30.0,
    record: Annotated[bool, typer.Option("--record", help="Write the figures into the model's contract.")] = False,
    service: Annotated[
        bool, typer.Option("--service", help="Also play them through the deployed service, over Zenoh.")
    ] = False,
) -> None:
    """Play fresh seeds with the deterministic policy and print a table of successes, steps and peak forces."""
    try:
        policy = Policy.load(model)
        part: Any = policy.contract.parts[0]
        levels = [level * 1e-3 for level in clearance or [2.0, 1.33, 0.33]]
        for level in levels:
            evaluate.Task(first_seed, part, level, conditions).check()
    except (PolicyError, ValueError) as error:
        _fail(str(error))
    cells = max(n for n in range(1, MOST_CELLS + 1) if episodes % n == 0)
    reports: list[evaluate.Report] = []
    with typer.progressbar(length=episodes * len(levels), label=policy.contract.name) as bar:
        for level in levels:
            reports.append(
                evaluate.evaluate(
                    policy,
                    level,
                    episodes,
                    part=part,
                    conditions=conditions,
                    first_seed=first_seed,
                    cells=cells,
                    threads=threads,
                    force_ceiling_n=force_ceiling,
                    on_episodes=bar.update,
                )
            )
    typer.echo("\n".join([evaluate.HEADER, *(report.line() for report in reports)]))
    if record:
        _record(model, [report.figure() for report in reports])
    if service:
        _through_service(model, part, reports, force_ceiling)


def _record(model: Path, figures: list[EvaluationFigure]) -> None:
    try:
        from training.export import record_evaluation
    except ImportError as error:
        _fail(f"recording needs the extra `training` ({error}): make setup-training")
    policy = record_evaluation(model, figures)
    typer.echo(f"recorded in {model}, whose SHA-256 is now {policy.sha256}")


def _through_service(model: Path, part: Part, reports: list[evaluate.Report], force_ceiling_n: float) -> None:
    from training import through_service

    try:
        for report in reports:
            seeds = [episode.seed for episode in report.episodes]
            with typer.progressbar(length=len(seeds), label=f"service, {report.clearance_m * 1e3:.2f} mm") as bar:
                played = through_service.play(
                    model,
                    seeds,
                    report.clearance_m,
                    part=part,
                    conditions=report.conditions,
                    force_ceiling_n=force_ceiling_n,
                    on_episode=bar.update,
                )
            typer.echo("\n" + through_service.table(report, played))
    except through_service.ServiceError as error:
        _fail(str(error))


def _commit() -> str | None:
    """Return the commit of the working tree, marked if it is not as committed; None where that is not known."""
    git = shutil.which("git")
    if git is None:
        return None
    done = subprocess.run(
        [git, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout.strip() or None


def _fail(text: str) -> NoReturn:
    typer.echo(f"training: {text}", err=True)
    raise typer.Exit(EXIT_USAGE)


if __name__ == "__main__":
    app()
