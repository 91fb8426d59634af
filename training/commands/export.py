"""`export`: write the policy file of a training."""

from pathlib import Path
from typing import Annotated, Any

import typer

from training.commands.refusal import refuse, refuse_without_extra
from training.learning.experiment import ExperimentError, load


def export(
    model: Annotated[str, typer.Argument(help="Name of a trained experiment, or a file of weights that ends in .pt.")],
    out: Annotated[Path, typer.Argument(help="ONNX file to write.")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of the training.")] = 0,
    last: Annotated[bool, typer.Option("--last", help="Take the latest weights, not the best ones.")] = False,
    experiment: Annotated[
        str, typer.Option(help="Experiment whose contract to take where the weights name none.")
    ] = "",
    name: Annotated[str, typer.Option(help="Name of the policy; default: the experiment's.")] = "",
) -> None:
    """Write a trained policy: network, normalisation and contract in one file."""
    try:
        from training.learning.export import export as write
        from training.learning.export import network_of
        from training.learning.run import CheckpointError, account_beside, contract_in, directory_of, read
    except ImportError as error:
        refuse_without_extra("export", error)
    path = (
        Path(model) if model.endswith(".pt") else directory_of(model, seed) / ("checkpoint.pt" if last else "best.pt")
    )
    try:
        weights = read(path)
        contract = contract_in(weights) or (load(experiment).contract() if experiment else None)
        if contract is None:
            refuse("export", f"{path} does not say what it was trained for: name its --experiment")
        provenance: dict[str, Any] = {"steps": weights["steps"]} | account_beside(path)
        provenance |= {key: weights[key] for key in ("elapsed_s", "validation") if key in weights}
        contract = contract.model_copy(update={"name": name or contract.name, "provenance": provenance})
        policy = write(network_of(contract, weights["net"]), contract, out)
    except (CheckpointError, ExperimentError, ValueError) as error:
        refuse("export", str(error))
    typer.echo(f"wrote {out}: {policy.contract.name}, {out.stat().st_size} bytes, SHA-256 {policy.sha256}")
