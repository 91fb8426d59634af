"""What the shipped policies see, do and are limited by: contracts to train against, before there is anything to measure."""

from service.policy.contract import ActionEntry, ComplianceLaw, ObservationEntry, PolicyContract
from service.safety.dsl import DslParameters

LAW = ComplianceLaw(
    stiffness=(2500.0, 2500.0, 3000.0, 5.0, 5.0, 8.0),
    damping=(380.0, 380.0, 650.0, 1.0, 1.0, 0.5),
    inertia=(2.5, 2.5, 2.5, 0.06, 0.06, 0.03),
)
"""Soft in rotation about the tip, so that a corner that drops in turns the peg; the damping is what 8 ms of delay allow."""

LOCK = DslParameters(mode="paper", seek_step_m=3e-3)
"""The paper's lock. Its increment presses with stiffness times increment, 9 N, where contact counts from 5 N."""

_SEEN = (
    ObservationEntry.of("hole_offset_xy", scale=3e-3, clip=4.0, history=4),
    ObservationEntry.of("height", scale=3e-3, clip=4.0, history=6),
    ObservationEntry.of("contact_height_known"),
    ObservationEntry.of("yaw", scale=0.6, clip=3.0, history=6),
    ObservationEntry.of("tilt", scale=0.02, clip=3.0, history=6),
    ObservationEntry.of("force_mean", scale=5.0, clip=3.0, history=8),
    ObservationEntry.of("torque_mean", scale=0.05, clip=4.0, history=8),
    ObservationEntry.of("force_z_range", scale=5.0, clip=3.0, history=4),
    ObservationEntry.of("contact_centroid", scale=8e-3, clip=3.0, history=8),
    ObservationEntry.of("lag", scale=(2e-3, 2e-3, 2e-3, 0.1), clip=3.0, history=8),
    ObservationEntry.of("previous_action", history=8),
    ObservationEntry.of("lock_height", scale=2e-3, clip=3.0, history=4),
    ObservationEntry.of("phase", history=4),
    ObservationEntry.of("time_fraction"),
)


def vftm_dsl(name: str = "tr-vftm-dsl") -> PolicyContract:
    """The triangle's policy: hole estimate, force and torque, the paper's lock."""
    return PolicyContract(
        name=name,
        parts=("tr",),
        clearance_m=(0.25e-3, 4e-3),
        mode="VFTM",
        ticks_per_step=50,
        max_steps=110,
        observation=_SEEN,
        action=(
            ActionEntry(name="dx", unit="m", frame="tool", limit=4e-3, map="signed_square"),
            ActionEntry(name="dy", unit="m", frame="tool", limit=4e-3, map="signed_square"),
            ActionEntry(name="dz", unit="m", frame="base", limit=1.5e-3),
            ActionEntry(name="dyaw", unit="rad", frame="base", limit=0.175, map="signed_square"),
        ),
        dsl=LOCK,
        compliance=LAW,
        wrench_window_ticks=25,
    )
