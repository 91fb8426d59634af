"""Configuration of a cell: one TOML file, overridden by the environment. Errors name the field.

The file is `$DSL_ASSEMBLY_CONFIG`, else `cell.toml`, else `config/cell.toml`. A variable such as
`DSL_ASSEMBLY__API__PORT=8001` overrides one field. Relative paths are relative to the file.
"""

from service.config.cell_config import CellConfig
from service.config.limits import LimitsSection, PreflightSection, WitnessSection
from service.config.loading import DEFAULT_PATHS, PATH_VARIABLE, ConfigError, find, load, why_edited
from service.config.sections import (
    ApiSection,
    CameraSection,
    CellSection,
    ClientLossSection,
    RecipeSection,
    SimSection,
)
from service.config.ur import UrSection

__all__ = [
    "DEFAULT_PATHS",
    "PATH_VARIABLE",
    "ApiSection",
    "CameraSection",
    "CellConfig",
    "CellSection",
    "ClientLossSection",
    "ConfigError",
    "LimitsSection",
    "PreflightSection",
    "RecipeSection",
    "SimSection",
    "UrSection",
    "WitnessSection",
    "find",
    "load",
    "why_edited",
]
