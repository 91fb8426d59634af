"""`openapi`: the description of the HTTP interface."""

import json

import typer


def openapi() -> None:
    """Print the OpenAPI document of the HTTP interface.

    `dsl-assembly openapi > tests/api/openapi.json` renews the committed copy after the interface has changed.
    """
    from api.application import build_routes

    typer.echo(json.dumps(build_routes().openapi(), indent=1))
