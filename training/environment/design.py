"""What a policy sees, does and is limited by: contracts to train against, before there is anything to measure."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from service.policy.contract import ActionEntry, ObservationEntry, PolicyContract
from service.policy.observation import ENTRIES, Need, ObservationMode
from service.safety.dsl import DslParameters
from wire.law import ComplianceLaw
from wire.limits import LockMode
from wire.task import Conditions, Part

LAW = ComplianceLaw(
    stiffness=(2500.0, 2500.0, 3000.0, 5.0, 5.0, 8.0),
    damping=(380.0, 380.0, 650.0, 1.0, 1.0, 0.5),
    inertia=(2.5, 2.5, 2.5, 0.06, 0.06, 0.03),
)
"""Soft in rotation about the tip, so that a corner that drops in turns the peg; damped as 8 ms of delay allow."""

LOCK = DslParameters(mode="paper", seek_step_m=3e-3)
"""The paper's lock. Its increment presses with stiffness times increment, 9 N, where contact counts from 5 N."""

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
    """Contract of a policy to be.

    Args:
        mode: VFTM sees the hole's estimate and the contact, FTM the nominal centre and the contact, VM the estimate
            and nothing of the contact.
        lock: how the depth is limited; None: `paper`, and `off` in mode VM, which has no other.
        part: peg and hole, or several.
        clearance_m: least and largest clearance per face that it is meant for.
        max_steps: of an episode.
        name: of the policy; None: made of the rest.
        law: the compliance law around the target.
        hidden_size: of a recurrent policy's state. Such a one sees a single frame, another one the last few.

    Raises:
        ValueError: these do not go together; the text names the field.
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
    """Change what is not None of a contract.

    Args:
        contract: to change.
        press_m: how far below the lock a command may go.
        limits: displacement at ±1 by action component, m and rad; for components that the contract lacks: nothing.
        wrench_window_ticks: newest samples of a step that are averaged.

    Raises:
        ValueError: the result does not fit together.
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
    """Raise ValueError for conditions that put the hole beyond what a policy of this mode can know of it."""
    if mode == "FTM" and conditions in ("standard", "stiff", "transfer"):
        raise ValueError(f"conditions {conditions!r} put the hole too far from the nominal centre, all that FTM knows")


def vftm_dsl(name: str = "tr-vftm-dsl") -> PolicyContract:
    """The triangle's policy: hole estimate, force and torque, the paper's lock."""
    return contract_for("VFTM", "paper", "tr", name=name)
