"""`gallery`: draw a policy's insertions, one per part."""

from pathlib import Path
from typing import Annotated, cast

import typer

from service.policy.model import Policy, PolicyError
from sim_backend.world.rendering import RenderingUnavailableError
from training.commands.refusal import refuse, refuse_without_extra
from training.environment import design
from training.report import paper
from wire.exits import Exit
from wire.task import Conditions, Part, Task

GALLERY = Path("docs/gallery")


def gallery(
    model: Annotated[Path, typer.Argument(help="ONNX file of the policy.")],
    part: Annotated[
        list[str] | None, typer.Option(help="Part to draw; may be repeated. Default: all parts of the policy.")
    ] = None,
    clearance: Annotated[float, typer.Option(help="Clearance per face, mm.")] = 1.33,
    conditions: Annotated[
        Conditions | None, typer.Option(help="Conditions of an episode; default: `search` for FTM, else `standard`.")
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, max=500, help="Number of test episodes to choose from.")] = 20,
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = GALLERY,
) -> None:
    """Draw each part's insertion of median length: PART.gif, PART.png, and a page that shows them all."""
    try:
        from training.report import gallery as drawing
    except ImportError as error:
        refuse_without_extra("gallery", error)
    try:
        policy = Policy.load(model)
        drawn = conditions or paper.conditions_for(policy.contract.mode)
        design.check_conditions(policy.contract.mode, drawn)
        parts: list[Part] = [cast(Part, name) for name in part or policy.contract.parts]
        for name in parts:
            Task(0, name, 1e-3 * clearance, drawn).check()
    except (PolicyError, ValueError) as error:
        refuse("gallery", str(error))
    out.mkdir(parents=True, exist_ok=True)
    films: list[drawing.Film] = []
    try:
        with typer.progressbar(parts, label="drawing") as bar:
            for name in bar:
                task = drawing.typical_success(policy, name, 1e-3 * clearance, drawn, seeds)
                if task is None:
                    typer.echo(f"\n{name}: none of {seeds} seeds succeeds, nothing is drawn", err=True)
                    continue
                films.append(drawing.film(policy, task))
                drawing.write_animation(out / f"{name}.gif", films[-1])
                drawing.write_strip(out / f"{name}.png", films[-1])
    except RenderingUnavailableError as error:
        refuse("gallery", str(error), Exit.HOST)
    if not films:
        refuse("gallery", "there is nothing to show")
    (out / "README.md").write_text(drawing.page(films))
    typer.echo(f"wrote {len(films)} insertions to {out}")
