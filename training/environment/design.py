"""Contracts to train against: observation, action, lock and limits of a policy that has no measured results yet."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from service.policy.contract import ActionEntry, ObservationEntry, PolicyContract
from service.policy.observation import ENTRIES, Need, ObservationMode, uses_estimate
from service.safety.dsl import DslParameters
from wire.law import ComplianceLaw
from wire.modes import LockMode
from wire.task import Conditions, Part

LAW = ComplianceLaw(
    stiffness=(2500.0, 2500.0, 3000.0, 5.0, 5.0, 8.0),
    damping=(380.0, 380.0, 650.0, 1.0, 1.0, 0.5),
    inertia=(2.5, 2.5, 2.5, 0.06, 0.06, 0.03),
)
"""Default compliance law. It is soft in rotation about the tip, so that a corner that drops in turns the peg. It is
damped as far as 8 ms of delay allow."""

LOCK = DslParameters(mode="paper", seek_step_m=3e-3)
"""Default lock: the paper's. One increment presses with stiffness times increment, 9 N; contact counts from 5 N."""

MAX_STEPS = 110

_SEEN = (
    ObservationEntry.of("hole_offset_xy", scale=3e-3, clip=4.0, history=8),
    ObservationEntry.of("height", scale=3e-3, clip=4.0, history=8),
    ObservationEntry.of("contact_height_known"),
    ObservationEntry.of("yaw", scale=0.6, clip=3.0, history=8),
    ObservationEntry.of("tilt", scale=0.02, clip=3.0, history=8),
    ObservationEntry.of("force_mean", scale=5.0, clip=3.0, history=8),
    ObservationEntry.of("torque_mean", scale=0.05, clip=4.0, history=8),
    ObservationEntry.of("force_z_range", scale=5.0, clip=3.0, history=4),
    ObservationEntry.of("contact_centroid", scale=8e-3, clip=3.0, history=12),
    ObservationEntry.of("lag", scale=(2e-3, 2e-3, 2e-3, 0.1), clip=3.0, history=8),
    ObservationEntry.of("previous_action", history=4),
    ObservationEntry.of("lock_height", scale=2e-3, clip=3.0, history=4),
    ObservationEntry.of("phase", history=4),
    ObservationEntry.of("time_fraction"),
)

_DONE = (
    ActionEntry(name="dx", unit="m", frame="tool", limit=4e-3, map="signed_square"),
    ActionEntry(name="dy", unit="m", frame="tool", limit=4e-3, map="signed_square"),
    ActionEntry(name="dz", unit="m", frame="base", limit=1.5e-3),
    ActionEntry(name="dyaw", unit="rad", frame="base", limit=0.175, map="signed_square"),
)


def contract_for(
    mode: ObservationMode = "VFTM",
    lock: LockMode | None = None,
    part: Part | Sequence[Part] = "tr",
    *,
    clearance_m: tuple[float, float] = (0.25e-3, 4e-3),
    max_steps: int = MAX_STEPS,
    name: str | None = None,
    law: ComplianceLaw = LAW,
    hidden_size: int = 0,
) -> PolicyContract:
    """Return the contract of a policy that is to be trained.

    Args:
        mode: observed quantities. VFTM: the hole's estimate and the contact. FTM: the nominal centre and the contact.
            VM: the hole's estimate only.
        lock: mode of the depth lock; None: `paper`, or `off` in mode VM, which allows no other.
        part: peg and hole, or several of them.
        clearance_m: least and largest clearance per face that the policy is meant for, m.
        max_steps: length of an episode, steps.
        name: name of the policy; None: composed of parts, mode and lock.
        law: compliance law around the target.
        hidden_size: size of a recurrent policy's state; 0: not recurrent. A recurrent policy observes a single frame,
            any other policy the last few.

    Raises:
        ValueError: the arguments contradict each other; the text names the field.
    """
    lock = lock or ("off" if mode == "VM" else "paper")
    parts = (part,) if isinstance(part, str) else tuple(part)
    return PolicyContract(
        name=name or f"{'-'.join(parts)}-{mode.lower()}-{lock}",
        parts=parts,
        clearance_m=clearance_m,
        mode=mode,
        ticks_per_step=50,
        max_steps=max_steps,
        observation=tuple(
            entry.model_copy(update={"history": 1}) if hidden_size else entry
            for entry in _SEEN
            if mode != "VM" or Need.FORCE_TORQUE not in ENTRIES[entry.name].needs
        ),
        action=_DONE,
        dsl=replace(LOCK, mode=lock),
        compliance=law,
        wrench_window_ticks=25,
        hidden_size=hidden_size,
    )


def adjusted(
    contract: PolicyContract,
    *,
    press_m: float | None = None,
    limits: Mapping[str, float] | None = None,
    wrench_window_ticks: int | None = None,
) -> PolicyContract:
    """Return a contract with every argument that is not None changed.

    Args:
        contract: contract to change.
        press_m: largest distance that a command may go below the lock, m.
        limits: displacement at ±1 by action component, m and rad. A component that the contract lacks is ignored.
        wrench_window_ticks: number of newest samples of a step that are averaged.

    Raises:
        ValueError: the result contradicts itself.
    """
    limits = limits or {}
    document = contract.model_dump()
    if press_m is not None:
        document["dsl"]["press_m"] = press_m
    for entry in document["action"]:
        entry["limit"] = limits.get(entry["name"], entry["limit"])
    if wrench_window_ticks is not None:
        document["wrench_window_ticks"] = wrench_window_ticks
    return PolicyContract.model_validate(document)


def check_conditions(mode: ObservationMode, conditions: Conditions) -> None:
    """Refuse conditions in which a policy of this mode cannot find the hole.

    Raises:
        ValueError: the hole lies too far from the nominal centre, and the mode observes nothing else of it.
    """
    if not uses_estimate(mode) and conditions in ("standard", "stiff", "transfer"):
        raise ValueError(
            f"conditions {conditions!r} put the hole too far from the nominal centre, and FTM observes only that centre"
        )


def vftm_dsl(name: str = "tr-vftm-dsl") -> PolicyContract:
    """Return the contract of the triangle's policy: hole estimate, force and torque, the paper's lock."""
    return contract_for("VFTM", "paper", "tr", name=name)
