"""Finds, reads and checks the configuration file."""

import os
import tomllib
from pathlib import Path

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from service.config.cell_config import CellConfig, Source
from service.config.units import likely
from service.program import PROGRAM

PATH_VARIABLE = "DSL_ASSEMBLY_CONFIG"
DEFAULT_PATHS = (Path("cell.toml"), Path("config/cell.toml"))
"""Looked for in the working directory: in a cell's own folder, and in a checkout of this project."""


class ConfigError(ValueError):
    """The configuration cannot be used; the text names every field that is wrong."""


def find(path: Path | None = None) -> Path:
    """Return the absolute path of the configuration: `path`, else `$DSL_ASSEMBLY_CONFIG`, else one of `DEFAULT_PATHS`.

    Raises:
        ConfigError: nothing names one, and the working directory has none, or more than one.
    """
    if path is None and (named := os.environ.get(PATH_VARIABLE)) is not None:
        path = Path(named)
    if path is None:
        found = [default for default in DEFAULT_PATHS if default.is_file()]
        if len(found) > 1:
            raise ConfigError(f"{' and '.join(map(str, found))} are both in {Path.cwd()}: name one by --config")
        if not found:
            raise ConfigError(
                f"no configuration: there is no {' and no '.join(map(str, DEFAULT_PATHS))} in {Path.cwd()}; name one "
                f"by --config or ${PATH_VARIABLE}, or write a cell's folder: {PROGRAM} config new FOLDER"
            )
        path = found[0]
    return path.resolve()


def load(path: Path | None = None) -> CellConfig:
    """Read and check the configuration.

    Args:
        path: the TOML file; None takes the one that `find` finds.

    Raises:
        ConfigError: no such file, not TOML, or a field that is missing, unknown or out of range.
    """
    path = find(path)
    if not path.is_file():
        raise ConfigError(f"no configuration at {path}; to write a cell's folder: {PROGRAM} config new FOLDER")
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ConfigError(f"{path} is not TOML: {error}") from error
    try:
        return _with_absolute_paths(CellConfig(**document), path.parent).read_from(Source(path, document))
    except ValidationError as error:
        lines = [f"  {_field(problem['loc'])}: {_said(problem)}" for problem in error.errors()]
        raise ConfigError("\n".join([f"{path} cannot be used:", *lines])) from error


def why_edited(config: CellConfig) -> str | None:
    """Return why a configuration is no longer that of its file; None while it is, or if it has no file. Blocks."""
    if (source := config.source) is None:
        return None
    try:
        present = tomllib.loads(source.path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        return f"{source.path} can no longer be read: {error}; restore it, or restart the control process"
    if present == source.document:
        return None
    names = sorted(name for name in {*present, *source.document} if present.get(name) != source.document.get(name))
    return (
        f"{source.path} was edited since the control process read it (in {', '.join(names)}), and the limits in force "
        "are the old ones: restart the control process, or undo the edit"
    )


def _field(location: tuple[int | str, ...]) -> str:
    return ".".join(str(part) for part in location) or "(whole file)"


def _said(problem: ErrorDetails) -> str:
    if problem["type"] == "extra_forbidden":
        return f"no such field; `{PROGRAM} config schema` lists them"
    if problem["type"] == "value_error":
        return problem["msg"].removeprefix("Value error, ")
    given = f", not {problem['input']!r}" if isinstance(problem["input"], str | int | float) else ""
    context = problem.get("ctx", {})
    hint = likely(problem["loc"], problem["input"], context.get("le", context.get("ge")))
    return problem["msg"] + given + ("" if hint is None else f": {hint}")


def _with_absolute_paths(config: CellConfig, base: Path) -> CellConfig:
    cell = config.cell.model_copy(update={"state_dir": (base / config.cell.state_dir).resolve()})
    recipes = {
        name: recipe.model_copy(update={"policy": (base / recipe.policy).resolve()})
        for name, recipe in config.recipes.items()
    }
    tls = config.tls
    if tls is not None:
        files = {name: (base / getattr(tls, name)).resolve() for name in ("authority", "certificate", "key")}
        tls = tls.model_copy(update=files)
    return config.model_copy(update={"cell": cell, "recipes": recipes, "tls": tls})
