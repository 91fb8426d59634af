"""Where the running API is."""

from typing import Annotated

import typer

URL_VARIABLE = "DSL_ASSEMBLY_URL"
DEFAULT_URL = "http://127.0.0.1:8000"

Url = Annotated[str, typer.Option(envvar=URL_VARIABLE, metavar="URL", help="Address of the running API.")]
