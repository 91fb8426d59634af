"""The policies of a cell's recipes: loaded once, run from memory, refused when the file has changed since."""

import hashlib

from service.cell.fit import CellCapabilities, mismatches
from service.config import CellConfig, RecipeSection
from service.policy.model import SIZE_LIMIT_BYTES, Policy, PolicyError


class PolicyRefusedError(Exception):
    """The policy of a recipe cannot be run on this cell; the text says why and what to do."""


class PolicyShelf:
    """Loads every recipe's policy at start-up and keeps it.

    A policy that cannot be used does not stop the cell from working: its recipe is refused, with the reason.

    Args:
        config: of the cell.
        tick_s: period of the driver's samples.
    """

    def __init__(self, config: CellConfig, tick_s: float) -> None:
        self._recipes = config.recipes
        self._loaded = {
            name: _load(recipe, CellCapabilities.of(config, recipe, tick_s)) for name, recipe in config.recipes.items()
        }

    def admit(self, recipe: str) -> Policy:
        """Return a recipe's policy, if its file is still the one that was loaded. Blocks on the disk.

        Raises:
            PolicyRefusedError: it could not be loaded, does not fit this cell, or its file was replaced since.
        """
        policy = self._loaded[recipe]
        if isinstance(policy, PolicyRefusedError):
            raise policy
        path = self._recipes[recipe].policy
        try:
            with path.open("rb") as file:
                present = hashlib.sha256(file.read(SIZE_LIMIT_BYTES + 1)).hexdigest()
        except OSError as error:
            raise PolicyRefusedError(f"{path} can no longer be read: {error.strerror}") from error
        if present != policy.sha256:
            raise PolicyRefusedError(
                f"{path} was replaced since it was admitted (SHA-256 {policy.sha256[:12]}…, now {present[:12]}…): "
                "restart the control process to admit the new one"
            )
        return policy


def _load(recipe: RecipeSection, cell: CellCapabilities) -> Policy | PolicyRefusedError:
    try:
        policy = Policy.load(recipe.policy, expected_sha256=recipe.policy_sha256)
    except PolicyError as error:
        return PolicyRefusedError(str(error))
    if reasons := mismatches(policy.contract, cell):
        return PolicyRefusedError(f"{recipe.policy} does not fit this cell: {'; '.join(reasons)}")
    return policy
