"""Address of the cell that a command is about: its API and its control process.

The configuration is read here without `service.config`, which takes longer to load than a stop may wait. Only the
fields of the address are read, so a configuration with another wrong field still names the cell to stop.
"""

import json
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self, cast
from urllib.parse import urlsplit

import typer

from wire.tls import Certificates

URL_VARIABLE = "DSL_ASSEMBLY_URL"
DEFAULT_URL = "http://127.0.0.1:8000"
PATH_VARIABLE = "DSL_ASSEMBLY_CONFIG"
DEFAULT_PATHS = (Path("cell.toml"), Path("config/cell.toml"))
FIELD_VARIABLE = "DSL_ASSEMBLY__"
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
DEFAULT_HOST = "127.0.0.1"
DEFAULT_PORT = 8000
_ANY_ADDRESS = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # noqa: S104 - a server that listens there is asked on loopback
_LOOPBACK = frozenset({"127.0.0.1", "localhost", "::1"})

Url = Annotated[
    str | None,
    typer.Option(
        envvar=URL_VARIABLE,
        metavar="URL",
        help=f"Address of the running API; default: that of the configuration, else {DEFAULT_URL}.",
    ),
]
CellFile = Annotated[
    Path | None,
    typer.Option(
        "--config",
        help=f"TOML file of the cell; default ${PATH_VARIABLE}, else cell.toml, else config/cell.toml.",
    ),
]


class AddressError(ValueError):
    """The configuration names no cell; the text says why."""


@dataclass(frozen=True, slots=True)
class CellAddress:
    """Address of a configured cell.

    Attributes:
        cell: id of the cell.
        endpoint: Zenoh endpoint of its control process.
        url: of its API.
        certificates: of the configuration; None without any.
    """

    cell: str
    endpoint: str
    url: str
    certificates: Certificates | None = None

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a configuration file and the variables that override its fields.

        Raises:
            AddressError: the file cannot be read, is not TOML, or names no cell.
        """
        try:
            document = tomllib.loads(path.read_text(encoding="utf-8"))
            cell, api = _section(document, "cell"), _section(document, "api")
            host = str(api.get("host", DEFAULT_HOST))
            host = _ANY_ADDRESS.get(host, host)
            port = int(api.get("port", DEFAULT_PORT))
            url = f"http://{f'[{host}]' if ':' in host else host}:{port}"
            endpoint = str(cell.get("endpoint", DEFAULT_ENDPOINT))
            return cls(str(cell["id"]), endpoint, url, _certificates(_section(document, "tls"), path.parent))
        except OSError as error:
            raise AddressError(f"the configuration {path} cannot be read: {error.strerror}") from error
        except KeyError as error:
            raise AddressError(f"the configuration {path} names no cell: cell.id is missing") from error
        except (ValueError, TypeError) as error:
            raise AddressError(f"the configuration {path} names no cell: {error}") from error

    def is_at(self, url: str) -> bool:
        """Return whether this URL is that of the configured API."""
        given, own = urlsplit(url), urlsplit(self.url)
        hosts = {given.hostname, own.hostname}
        return given.port == own.port and (len(hosts) == 1 or hosts <= _LOOPBACK)


def _certificates(tls: Mapping[str, Any], folder: Path) -> Certificates | None:
    names = ("authority", "certificate", "key")
    if not all(name in tls for name in names):
        return None
    authority, certificate, key = (folder / str(tls[name]) for name in names)
    return Certificates(authority, certificate, key)


def find_cell(path: Path | None) -> CellAddress | None:
    """Return the address of the configured cell: that of `path`, else of the file that `service.config.find` finds.

    Returns:
        None where nothing names a configuration and there is none in the working directory.

    Raises:
        AddressError: there is one, and it names no cell.
    """
    if path is None and (named := os.environ.get(PATH_VARIABLE)):
        path = Path(named)
    path = path or next((default for default in DEFAULT_PATHS if default.is_file()), None)
    return None if path is None else CellAddress.read(path)


def is_address(url: str) -> bool:
    """Return whether this can be the address of an API."""
    try:
        parts = urlsplit(url)
        return parts.scheme in {"http", "https"} and bool(parts.hostname) and parts.port != 0
    except ValueError:
        return False


def not_an_address(url: str) -> str:
    """Say that this is no address of an API."""
    return f"{url} is no address of an API: it looks like {DEFAULT_URL}"


def _section(document: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a section with its overrides: `DSL_ASSEMBLY__API` as JSON, then `DSL_ASSEMBLY__API__PORT` and so on."""
    section = document.get(name, {})
    if not isinstance(section, dict):
        raise TypeError(f"{name} is no section")
    found = dict(cast("dict[str, Any]", section))
    variables = {key.upper(): value for key, value in os.environ.items()}
    whole = FIELD_VARIABLE + name.upper()
    if whole in variables:
        found |= json.loads(variables[whole])
    prefix = f"{whole}__"
    return found | {key.removeprefix(prefix).lower(): v for key, v in variables.items() if key.startswith(prefix)}
