"""Address of the running API."""

from typing import Annotated
from urllib.parse import urlsplit

import typer

URL_VARIABLE = "DSL_ASSEMBLY_URL"
DEFAULT_URL = "http://127.0.0.1:8000"

Url = Annotated[str, typer.Option(envvar=URL_VARIABLE, metavar="URL", help="Address of the running API.")]


def is_address(url: str) -> bool:
    """Return whether this can be the address of an API."""
    try:
        parts = urlsplit(url)
        return parts.scheme in {"http", "https"} and bool(parts.hostname) and parts.port != 0
    except ValueError:
        return False
