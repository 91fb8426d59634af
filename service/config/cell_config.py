"""The configuration of one cell: its sections, and the check that they agree."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self, assert_never

from pydantic import Field, PrivateAttr, model_validator
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict

from service.config.checks import (
    between_limits_and_preflight,
    beyond_arm,
    recipes_beyond_limits,
    samples_too_rare,
    within_limits,
    within_preflight,
    without_robot,
)
from service.config.exposure import unprotected
from service.config.fields import Name
from service.config.limits import LimitsSection, PreflightSection, WitnessSection
from service.config.sections import (
    ApiSection,
    CameraSection,
    CellSection,
    ClientLossSection,
    RecipeSection,
    SimSection,
    TlsSection,
)
from service.config.ur import UrSection
from wire.tls import Certificates


@dataclass(frozen=True, slots=True)
class Source:
    """The file of a configuration.

    Attributes:
        path: the file.
        document: its content when it was read.
    """

    path: Path
    document: Mapping[str, Any]


class CellConfig(BaseSettings):
    """The configuration of one cell."""

    model_config = SettingsConfigDict(
        env_prefix="DSL_ASSEMBLY__", env_nested_delimiter="__", extra="forbid", frozen=True, validate_default=True
    )

    cell: CellSection
    limits: LimitsSection
    preflight: PreflightSection = PreflightSection()
    witness: WitnessSection = WitnessSection()
    sim: SimSection = SimSection()
    ur: UrSection | None = None
    camera: CameraSection | None = None
    tls: TlsSection | None = None
    api: ApiSection = ApiSection()
    client_loss: ClientLossSection = ClientLossSection()
    recipes: Annotated[dict[Name, RecipeSection], Field(min_length=1)]
    _source: Source | None = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        contradictions = (
            *within_limits(self.limits),
            *within_preflight(self.preflight),
            *between_limits_and_preflight(self.limits, self.preflight),
            *samples_too_rare(self.cell, self.sim, self.limits),
            *recipes_beyond_limits(self.recipes, self.limits),
            *without_robot(self.cell, self.ur),
            *(() if self.ur is None else beyond_arm(self.ur, self.recipes, self.limits)),
            *unprotected(self.cell, self.sim, self.camera, self.tls),
        )
        if contradictions:
            raise ValueError("; ".join(contradictions))
        return self

    def read_from(self, source: Source) -> Self:
        """Return a copy that knows the file that it was read from."""
        copied = self.model_copy()
        copied._source = source
        return copied

    @property
    def source(self) -> Source | None:
        """The file that it was read from; None where it was made in code."""
        return self._source

    @property
    def certificates(self) -> Certificates | None:
        """Certificates of this process; None without `[tls]`."""
        tls = self.tls
        return None if tls is None else Certificates(tls.authority, tls.certificate, tls.key)

    @property
    def asks_realtime(self) -> bool:
        """True where the cell's processes ask for real-time scheduling and locked memory."""
        if self.cell.realtime is not None:
            return self.cell.realtime
        return self.cell.driver == "ur" and self.ur is not None and not self.ur.simulated

    @property
    def sees_hole(self) -> bool:
        """True where something estimates the hole's position: the simulated cell's camera, or that of `[camera]`."""
        match self.cell.driver:
            case "zenoh_sim":
                return True
            case "ur":
                return self.camera is not None
            case _ as never:
                assert_never(never)

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        return (env_settings, init_settings)
