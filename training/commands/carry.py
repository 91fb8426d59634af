"""`carry`: carry results over a change of the sources that alters no episode, by playing episodes before and after."""

import signal
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer

from service.policy.model import PolicyError
from training.commands.refusal import refuse
from training.evaluation import carry as carrying
from training.evaluation import provenance
from training.evaluation.results import RESULTS, ResultsError
from wire.exits import Exit


def carry(
    revision: Annotated[str, typer.Argument(help="Revision whose sources the results are of.")],
    results: Annotated[
        list[Path] | None,
        typer.Option(help="Folder of results or one file; may be repeated. Default: results/ and its folders."),
    ] = None,
    models: Annotated[Path, typer.Option(help="Folder of the policies.")] = Path("models"),
    episodes: Annotated[int, typer.Option(min=1, help="Per block in the batched environment.")] = 4,
    service_episodes: Annotated[int, typer.Option(min=1, help="Per block through the service.")] = 2,
    environment_only: Annotated[
        bool,
        typer.Option("--environment-only", help="Leave the episodes through the service at their earlier sources."),
    ] = False,
) -> None:
    """Show that REVISION and the present sources play the same, bit for bit. Then carry the results over.

    The first seeds of every block are played in both trees, each by a process with that tree's own code. If one step of
    one episode differs, no file is changed. Episodes are also compared with those on file. They must be equal if 25
    are played at once, as in `evaluate`, with machine and versions as measured; otherwise the equal ones are counted.
    """
    signal.signal(signal.SIGTERM, _interrupt)
    folders = results or [RESULTS, RESULTS / "fresh-seeds", *sorted((RESULTS / "panels").glob("*/"))]
    paths = [path for folder in folders for path in (sorted(folder.glob("*.json")) if folder.is_dir() else [folder])]
    service = not environment_only
    try:
        jobs = carrying.jobs_of(paths, models, episodes, service_episodes, service=service)
        replays: dict[Path, list[carrying.Replay]] = {path: [] for path in paths}
        with (
            carrying.checkout(revision) as tree,
            carrying.Player(tree) as before,
            carrying.Player(provenance.ROOT) as after,
        ):
            earlier, present = before.sources(), after.sources()
            carrying.check(paths, earlier, service=service)
            with typer.progressbar(length=len(jobs), label="blocks") as bar:
                for job, replay in carrying.replay(jobs, before, after):
                    replays[job.path].append(replay)
                    bar.update(1)
            if after.sources().deployed_sources != present.deployed_sources:  # it covers all sources
                raise carrying.CarryError("the present sources changed meanwhile: play again")
    except KeyboardInterrupt:
        refuse("carry", "interrupted; nothing is changed", Exit.INTERRUPTED)
    except carrying.CarryError as error:
        refuse("carry", f"nothing is changed: {error}", Exit.FAILED)
    except (PolicyError, ResultsError) as error:
        refuse("carry", str(error))
    for path, found in replays.items():
        carrying.write(path, found, earlier, present, service=service)
    every = [replay for found in replays.values() for replay in found]
    for through, compared in carrying.COMPARED.items():
        played = [replay for replay in every if replay.through == through]
        if played:
            count, agreed = sum(r.episodes for r in played), sum(r.agreed for r in played)
            typer.echo(f"{through}: {agreed} of {count} episodes of {len(played)} blocks agree ({compared})")
            own = [(r.episodes, r.as_on_file) for r in played if r.as_on_file is not None]
            typer.echo(f"{through}: {sum(like for _, like in own)} of {sum(n for n, _ in own)} are as on file")
    typer.echo(f"carried {len(paths)} files from {earlier.sources[:12]} to {present.sources[:12]}")


def _interrupt(signum: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt
