"""The configured cell, on ports and in a folder of its own, so that a measurement disturbs no running cell."""

import os
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from benchmarks.harness.processes import free_port
from benchmarks.harness.result import UnavailableError
from service import config as configuration
from service.config import CellConfig, ConfigError


@dataclass(frozen=True, slots=True)
class ShippedCell:
    """Configuration of a cell for a measurement.

    Attributes:
        config: configuration as the control process would read it.
        environment: variables that make another process read the same configuration.
        recipe: name of the first recipe.
        policy: model of that recipe.
    """

    config: CellConfig
    environment: dict[str, str]
    recipe: str
    policy: Path


@contextmanager
def shipped_cell(file: Path | None = None, **overrides: str) -> Generator[ShippedCell]:
    """Read the configuration and replace ports and folder. The cell's processes ask for real-time scheduling.

    Args:
        file: file to read instead of the control process's own.
        **overrides: more fields, such as `limits__sample_age_s="0.5"`.

    Raises:
        UnavailableError: the configuration cannot be read, or its policy is missing.
    """
    with tempfile.TemporaryDirectory() as folder:
        fields = {
            "cell__endpoint": f"tcp/127.0.0.1:{free_port()}",
            "cell__state_dir": folder,
            "sim__endpoint": f"tcp/127.0.0.1:{free_port()}",
            "api__port": str(free_port()),
            "cell__realtime": "true",
            **overrides,
        }
        variables = {f"DSL_ASSEMBLY__{name.upper()}": value for name, value in fields.items()}
        try:
            variables[configuration.PATH_VARIABLE] = str(configuration.find(file))
        except ConfigError as error:
            raise UnavailableError(str(error)) from error
        before = {name: os.environ.get(name) for name in variables}
        os.environ.update(variables)
        try:
            config = configuration.load()
        except ConfigError as error:
            raise UnavailableError(str(error)) from error
        finally:
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value
        recipe, section = next(iter(config.recipes.items()))
        if not section.policy.is_file():
            raise UnavailableError(f"recipe {recipe} names {section.policy.name}, which is missing: train it first")
        yield ShippedCell(config, os.environ | variables, recipe, section.policy)
