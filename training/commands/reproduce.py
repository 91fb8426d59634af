"""`reproduce`: measure every shipped policy for the report, and compare with earlier results."""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from service.policy.model import Policy, PolicyError
from training.commands.evaluate import measure
from training.commands.refusal import refuse, refuse_without_extra
from training.evaluation.evaluate import FIRST_TEST_SEED
from training.evaluation.results import RESULTS, Results, ResultsError, Setting, exclusive
from training.report import paper
from wire.exits import Exit


def reproduce(
    models: Annotated[Path, typer.Option(help="Folder of the policies.")] = Path("models"),
    results: Annotated[Path, typer.Option(help="Folder to write the results to.")] = Path("var/reproduced"),
    against: Annotated[Path, typer.Option(help="Folder of the results to compare with.")] = RESULTS,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes per cell of the tables.")] = 500,
    workers: Annotated[int, typer.Option(min=0, help="Number of processes; 0: one per core.")] = 0,
) -> None:
    """Play all of the report's episodes again in the batched environment, and write the report of them.

    Episodes are kept: the same command again goes on. The report's learning curves are the earlier ones. The command
    fails if a success rate lies outside the 95 % interval of the earlier rate on the same seeds.
    """
    try:
        from training.report import curves, writing
        from training.report.measured import Measured
    except ImportError as error:
        refuse_without_extra("reproduce", error)
    different = 0
    for model in sorted(models.glob("*.onnx")):
        name = f"{model.stem}.json"
        try:
            policy = Policy.load(model)
            settings = settings_of(model.stem, policy)
            if not settings:
                continue
            with exclusive(results / name):
                found = measure(
                    model, policy, settings, results / name, episodes, workers or len(os.sched_getaffinity(0))
                )
            earlier = Results.load(against / name).unbroken() if (against / name).exists() else None
        except (PolicyError, ResultsError) as error:
            refuse("reproduce", str(error))
        for line in compared(found, earlier, settings):
            different += line.startswith("DIFFERENT")
            typer.echo(line)
    try:
        measured = replace(Measured.read(results), curves=tuple(curves.load(against)))
    except ResultsError as error:
        refuse("reproduce", str(error))
    typer.echo(f"wrote {writing.write(writing.document(measured), results)[0]}")
    if different:
        typer.echo(f"{different} differ from {against}: another file, or a rate outside the interval", err=True)
        raise typer.Exit(Exit.FAILED)


def settings_of(name: str, policy: Policy) -> list[Setting]:
    """Return all settings that the report shows of a policy, each once."""
    contract = policy.contract
    settings = [
        Setting(
            part=part,
            clearance_m=clearance,
            conditions=conditions,
            lock=lock or contract.dsl.mode,
            first_seed=FIRST_TEST_SEED,
        )
        for part, clearance, conditions, lock in paper.reported(name, contract.mode)
    ]
    return list(dict.fromkeys(settings))


def compared(found: Results, earlier: Results | None, settings: list[Setting]) -> Iterator[str]:
    """Yield one line per setting: the rate, and whether it lies within the interval of the earlier rate."""
    if earlier is not None and earlier.sha256 != found.sha256:
        yield f"DIFFERENT  {found.policy}: the earlier results are of another file of that name"
    if earlier is not None and earlier.sources != found.sources:
        yield f"NOTE       {found.policy}: world, arm, lock or criterion have changed since the earlier results"
    for setting in settings:
        block = found.block(setting)
        known = None if earlier is None else earlier.block(setting).first(len(block.episodes))
        told = f"{found.policy} {setting.part} {setting.clearance_m * 1e3:.2f} mm {setting.conditions} {setting.lock}"
        if known is None or not known.episodes:
            yield f"new        {told}: {block.rate:.1%}"
            continue
        low, high = known.interval
        verdict = "as before " if low <= block.rate <= high else "DIFFERENT "
        before = f"{known.rate:.1%} ({low:.1%} to {high:.1%}), n = {len(known.episodes)}"
        yield f"{verdict} {told}: {block.rate:.1%}, before {before}"
