"""The policies that a cell has admitted: loaded once, run from memory, refused when the file has changed since."""

import hashlib
from collections.abc import Mapping
from pathlib import Path

from service.config import LimitsSection, RecipeSection
from service.policy.contract import CellCapabilities
from service.policy.model import SIZE_LIMIT_BYTES, Policy, PolicyError


class PolicyRefusedError(Exception):
    """A recipe's policy cannot be run on this cell; the text says why and what to do."""


class PolicyShelf:
    """Loads every recipe's policy at start-up and keeps what it loaded.

    A policy that cannot be used does not keep the cell from working: its recipe is refused, with the reason.

    Args:
        recipes: by name.
        tick_s: of the cell.
        limits: of the cell.
    """

    def __init__(
        self,
        recipes: Mapping[str, RecipeSection],
        tick_s: float,
        limits: LimitsSection,
    ) -> None:
        self._loaded: dict[str, Policy | PolicyRefusedError] = {}
        self._paths: dict[str, Path] = {}
        for name, recipe in recipes.items():
            self._paths[name] = recipe.policy
            offered = CellCapabilities(
                tick_s=tick_s,
                part=recipe.part,
                clearance_m=recipe.clearance_m,
                camera=True,
                force_torque=True,
                last_joint=True,
                stiffness_max=limits.max_stiffness,
                damping_min=limits.min_damping,
                inertia_min=limits.min_inertia,
                locks=recipe.allow_lock,
                press_max_m=limits.max_press_m,
            )
            self._loaded[name] = _load(recipe, offered)

    def admit(self, recipe: str) -> Policy:
        """Return a recipe's policy, if its file still is what was loaded. Blocks on the disk.

        Raises:
            PolicyRefusedError: it could not be loaded, does not fit this cell, or the file is another one now.
        """
        policy = self._loaded[recipe]
        if isinstance(policy, PolicyRefusedError):
            raise policy
        path = self._paths[recipe]
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


def _load(recipe: RecipeSection, offered: CellCapabilities) -> Policy | PolicyRefusedError:
    try:
        policy = Policy.load(recipe.policy, expected_sha256=recipe.policy_sha256)
    except PolicyError as error:
        return PolicyRefusedError(str(error))
    reasons = policy.contract.check_against(offered)
    if reasons:
        return PolicyRefusedError(f"{recipe.policy} does not fit this cell: {'; '.join(reasons)}")
    return policy
