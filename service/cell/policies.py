"""The policies that a cell has admitted: loaded once, run from memory, refused when the file has changed since."""

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path

from service.config import LimitsSection, RecipeSection
from service.policy.contract import CellCapabilities, PolicyContract
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
        camera: whether the cell has an estimate of the hole's position: `CellConfig.sees_hole`.
    """

    def __init__(
        self,
        recipes: Mapping[str, RecipeSection],
        tick_s: float,
        limits: LimitsSection,
        *,
        camera: bool,
    ) -> None:
        self._loaded: dict[str, Policy | PolicyRefusedError] = {}
        self._paths: dict[str, Path] = {}
        for name, recipe in recipes.items():
            self._paths[name] = recipe.policy
            offered = CellCapabilities(
                tick_s=tick_s,
                part=recipe.part,
                clearance_m=recipe.clearance_m,
                camera=camera,
                force_torque=True,
                last_joint=True,
                stiffness_max=limits.max_stiffness,
                damping_min=limits.min_damping,
                inertia_min=limits.min_inertia,
                locks=recipe.allow_lock,
                press_max_m=limits.max_press_m,
            )
            self._loaded[name] = _load(recipe, offered, limits)

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


def _load(recipe: RecipeSection, offered: CellCapabilities, limits: LimitsSection) -> Policy | PolicyRefusedError:
    try:
        policy = Policy.load(recipe.policy, expected_sha256=recipe.policy_sha256)
    except PolicyError as error:
        return PolicyRefusedError(str(error))
    contract = policy.contract
    reasons = [*contract.check_against(offered), *_beyond_law(contract, limits), *_beyond_lock(contract, limits)]
    if contract.mode != "FTM" and not offered.camera:
        reasons.append(
            f"mode {contract.mode} goes by a camera's estimate of the hole: describe the camera under [camera], "
            "or take a policy of mode FTM"
        )
    if reasons:
        return PolicyRefusedError(f"{recipe.policy} does not fit this cell: {'; '.join(reasons)}")
    return policy


def _beyond_law(contract: PolicyContract, limits: LimitsSection) -> Iterator[str]:
    """Damping and inertia above the cell's limits; `check_against` bounds the rest of the law."""
    law = contract.compliance
    for name, wanted, most in (
        ("damping", law.damping, limits.max_damping),
        ("inertia", law.inertia, limits.max_inertia),
    ):
        for axis, (want, limit) in enumerate(zip(wanted, most, strict=True)):
            if want > limit:
                yield f"compliance.{name}[{axis}] is {want:g}, limits.max_{name} of the cell is {limit:g}"


def _beyond_lock(contract: PolicyContract, limits: LimitsSection) -> Iterator[str]:
    """Constants with which a lock would be one in name only; `check_against` bounds its mode and `press_m`."""
    lock = contract.dsl
    if lock.mode == "off":
        return
    share = limits.max_contact_share
    for clip, value, ceiling, unit in (
        ("force_clip_n", lock.force_clip_n, limits.force_ceiling_n, "N"),
        ("torque_clip_nm", lock.torque_clip_nm, limits.torque_ceiling_nm, "N·m"),
    ):
        threshold = lock.contact_threshold * value
        if threshold > share * ceiling:
            yield (
                f"dsl.contact_threshold of dsl.{clip} is {threshold:g} {unit}, limits.max_contact_share of the cell's "
                f"ceiling is {share * ceiling:.3g} {unit}"
            )
    for name, want, field, limit in (
        ("seek_step_m", lock.seek_step_m, "max_seek_step_m", limits.max_seek_step_m),
        ("lift_max_m", lock.lift_max_m, "max_lift_m", limits.max_lift_m),
        ("search_depth_m", lock.search_depth_m, "max_search_depth_m", limits.max_search_depth_m),
        ("search_steps", lock.search_steps, "max_search_steps", limits.max_search_steps),
    ):
        if want > limit:
            yield f"dsl.{name} is {want:g}, limits.{field} of the cell is {limit:g}"
