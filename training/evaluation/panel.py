"""A panel: plants with errors on which a policy is measured, line by line, as one TOML file in `training/panels/`."""

import tomllib
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from training.evaluation.results import Results
from wire.plant import PlantErrors

FOLDER = Path(__file__).parents[1] / "panels"


class PanelError(ValueError):
    """A panel cannot be read; the text names the file and the value."""


def _plant(errors: Any) -> PlantErrors | None:
    plant = PlantErrors.from_json(errors)
    return None if plant == PlantErrors() else plant


class Panel(BaseModel):
    """A panel.

    Attributes:
        name: name of its file, without the ending.
        about: its purpose.
        first_seed: first seed of every line; the others follow it, so the lines are paired seed by seed.
        episodes: number of episodes per line and clearance unless the caller says otherwise.
        clearances_mm: clearances per face.
        lines: errors of the plant by the line's name; None: it has none.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    about: str
    first_seed: Annotated[int, Field(ge=0)]
    episodes: Annotated[int, Field(ge=1)]
    clearances_mm: Annotated[tuple[float, ...], Field(min_length=1)]
    lines: Annotated[dict[str, Annotated[PlantErrors | None, BeforeValidator(_plant)]], Field(min_length=1)]

    def path(self, results: Path, policy: str) -> Path:
        """Return the file of a policy's results on this panel, in the folder of all results."""
        return results / "panels" / self.name / f"{policy}.json"


def load(name: str) -> Panel:
    """Read a panel.

    Args:
        name: name of a panel in `training/panels/`, or the path of a file that ends in `.toml`.

    Raises:
        PanelError: there is no such panel, or it holds what no world can have.
    """
    path = Path(name) if name.endswith(".toml") else FOLDER / f"{name}.toml"
    try:
        return Panel.model_validate(tomllib.loads(path.read_text()) | {"name": path.stem})
    except FileNotFoundError as error:
        known = ", ".join(sorted(each.stem for each in FOLDER.glob("*.toml")))
        raise PanelError(f"there is no panel {name}; there are {known}, and files that end in .toml") from error
    except (OSError, tomllib.TOMLDecodeError, ValidationError) as error:
        raise PanelError(f"{path} holds no panel: {error}") from error


def read(results: Path) -> dict[str, dict[str, Results]]:
    """Return the results on all panels, by name of the panel and of the policy's file.

    Raises:
        ResultsError: a file holds no results.
    """
    found: dict[str, dict[str, Results]] = {}
    for path in sorted((results / "panels").glob("*/*.json")):
        found.setdefault(path.parent.name, {})[path.stem] = Results.load(path).unbroken()
    return found
