"""The policies of a cell's recipes: loaded once, run from memory, refused when the file has changed since."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from service.cell.fit import CellCapabilities, mismatches
from service.cell.inference import HeldPolicy, PolicyOpener
from service.config import CellConfig
from service.policy.contract import PolicyContract
from service.policy.model import SIZE_LIMIT_BYTES, PolicyError, PolicyFault


class PolicyRefusedError(Exception):
    """The policy of a recipe cannot be run on this cell; the text says why and what to do."""


@dataclass(frozen=True, slots=True)
class Admitted:
    """A policy that a run may use now.

    Attributes:
        held: begins the run's inference.
        sha256: hex digest of the file that was loaded.
        contract: of the policy.
    """

    held: HeldPolicy
    sha256: str
    contract: PolicyContract


class PolicyShelf:
    """Opens every recipe's policy at start-up and keeps it. Recipes with the same policy share it.

    A policy that cannot be used does not stop the cell from working: its recipe is refused, with the reason.

    Args:
        config: of the cell.
        tick_s: period of the driver's samples.
        opener: opens a policy's file.
    """

    def __init__(self, config: CellConfig, tick_s: float, opener: PolicyOpener) -> None:
        self._config = config
        self._tick_s = tick_s
        self._opener = opener
        self._closed = False
        self._held: dict[tuple[Path, str | None], HeldPolicy | PolicyError] = {}
        for recipe in config.recipes.values():
            key = recipe.policy, recipe.policy_sha256
            if key not in self._held:
                self._held[key] = self._open(*key)

    @property
    def settled(self) -> bool:
        """True once every policy is loaded or refused."""
        return all(isinstance(held, PolicyError) or held.settled for held in self._held.values())

    def admit(self, recipe: str) -> Admitted:
        """Return a recipe's policy, if its file is still the one that was loaded. Blocks on disk and loading.

        A policy whose process has ended since it was loaded is loaded anew.

        Raises:
            PolicyRefusedError: it could not be loaded, does not fit this cell, or its file was replaced since.
        """
        section = self._config.recipes[recipe]
        try:
            held = self._usable(section.policy, section.policy_sha256)
            sha256, contract = held.loaded()
        except PolicyError as error:
            raise PolicyRefusedError(str(error)) from error
        if reasons := mismatches(contract, CellCapabilities.of(self._config, section, self._tick_s)):
            raise PolicyRefusedError(f"{section.policy} does not fit this cell: {'; '.join(reasons)}")
        return Admitted(held, sha256, contract)

    def close(self) -> None:
        """Release every policy; a start that waits for one is refused. May block for a moment."""
        self._closed = True
        for held in list(self._held.values()):
            if not isinstance(held, PolicyError):
                held.close()

    def _usable(self, path: Path, pin: str | None) -> HeldPolicy:
        """Return a policy that is loaded and whose file is the one that was loaded.

        Raises:
            PolicyError: it cannot be loaded.
            PolicyRefusedError: its file was replaced.
        """
        held = self._held[path, pin]
        if isinstance(held, PolicyError):  # there was no process to be had; there may be one now
            held = self._held[path, pin] = self._open(path, pin)
        if not isinstance(held, PolicyError):
            sha256, _ = held.loaded()
            _check_file(path, sha256)
            if held.ended and not self._closed:
                held.close()
                held = self._held[path, pin] = self._open(path, sha256)
        if isinstance(held, PolicyError):
            raise held
        return held

    def _open(self, path: Path, sha256: str | None) -> HeldPolicy | PolicyError:
        try:
            return self._opener(path, sha256)
        except OSError as error:
            return PolicyError(PolicyFault.FAILED, f"no process for {path} can be made: {error.strerror}")


def _check_file(path: Path, sha256: str) -> None:
    try:
        with path.open("rb") as file:
            present = hashlib.sha256(file.read(SIZE_LIMIT_BYTES + 1)).hexdigest()
    except OSError as error:
        raise PolicyRefusedError(f"{path} can no longer be read: {error.strerror}") from error
    if present != sha256:
        raise PolicyRefusedError(
            f"{path} was replaced since it was admitted (SHA-256 {sha256[:12]}…, now {present[:12]}…): "
            "restart the control process to admit the new one"
        )
