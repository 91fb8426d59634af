"""`baseline`: write policies that nobody trained, to compare learned ones with."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from service.policy.model import Policy
from training import files
from training.commands.refusal import refuse_without_extra


class Baseline(StrEnum):
    """Policies that can be written."""

    SEARCH = "search"
    SEARCH_FTM = "search-ftm"
    STILL = "still"


def baseline(
    which: Annotated[
        Baseline,
        typer.Argument(help="Search about the camera's estimate, search about the nominal centre, or no motion."),
    ],
    out: Annotated[Path, typer.Argument(help="ONNX file to write.")],
) -> None:
    """Write a scripted policy: spiral and yaw sweep, or one that asks for nothing."""
    try:
        from training.evaluation import baseline as scripts
    except ImportError as error:
        refuse_without_extra("baseline", error)
    data = {
        Baseline.SEARCH: scripts.scripted_search,
        Baseline.SEARCH_FTM: lambda: scripts.scripted_search("FTM"),
        Baseline.STILL: scripts.still,
    }[which]()
    policy = Policy(data, source=str(out))
    files.write(out, data)
    typer.echo(f"wrote {out}: {policy.contract.name}, {len(data)} bytes, SHA-256 {policy.sha256}")
