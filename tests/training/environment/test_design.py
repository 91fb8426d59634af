import pytest

from service.policy.contract import PolicyContract
from service.policy.observation import ENTRIES, Need, ObservationMode
from training.environment import design
from wire.modes import LockMode

TOGETHER: list[tuple[ObservationMode, LockMode]] = [
    *((mode, lock) for mode in ("VFTM", "FTM") for lock in LockMode.__args__),
    ("VM", "off"),
]


@pytest.mark.parametrize(("mode", "lock"), TOGETHER)
def test_every_mode_and_lock_that_go_together_have_a_contract_that_survives_its_file(
    mode: ObservationMode, lock: LockMode
) -> None:
    contract = design.contract_for(mode, lock)
    assert PolicyContract.from_json(contract.to_json()) == contract
    assert (contract.mode, contract.dsl.mode) == (mode, lock)


def test_vm_feels_nothing_and_has_no_lock() -> None:
    contract = design.contract_for("VM")
    assert contract.dsl.mode == "off"
    assert not any(Need.FORCE_TORQUE in ENTRIES[entry.name].needs for entry in contract.observation)


@pytest.mark.parametrize("lock", ["paper", "sliding"])
def test_vm_with_a_lock_is_refused(lock: LockMode) -> None:
    with pytest.raises(ValueError, match=r"VM bypasses the lock"):
        design.contract_for("VM", lock)


def test_a_policy_has_all_four_components_under_every_lock() -> None:
    names = {lock: [entry.name for entry in design.contract_for("VFTM", lock).action] for lock in LockMode.__args__}
    assert all(components == ["dx", "dy", "dz", "dyaw"] for components in names.values())


def test_the_shipped_contract_is_vftm_under_the_papers_lock() -> None:
    contract = design.vftm_dsl()
    assert (contract.name, contract.parts, contract.mode, contract.dsl) == ("tr-vftm-dsl", ("tr",), "VFTM", design.LOCK)
