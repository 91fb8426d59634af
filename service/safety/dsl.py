"""The dynamic safety lock (DSL): limits the depth that a policy may ask for, from contact.

Algorithm 1 and equations 3 to 6 of the paper "DSL-Assembly: A Robust and Safe Assembly Strategy" (Y. Liu), any batch
shape. Comments name the line or equation that the code below them implements.

Frames and signs are those of `docs/reference/frames.md`: base frame, z up, insertion along -z, pressing gives Fz > 0.

NaN must never enter: it would pass into the lock and stay there. A cell's monitor refuses it before, and its bounds
after; nothing here looks, because this also runs over thousands of simulated cells.
"""

from dataclasses import dataclass, fields
from enum import IntEnum
from math import inf
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from wire.arrays import BoolArray, FloatArray, IntArray
from wire.limits import LockMode

Mode = LockMode


class Phase(IntEnum):
    """What governs a command."""

    SEEK = 0
    """No contact: creep down."""
    LOCKED = 1
    """In contact: z may not go below the lock. In `peck`: lifted to the record, about to press."""
    PRESSED = 2
    """`peck` only: below the record; the next step judges the wrench felt there."""
    FREE = 3
    """The policy owns z: `off` always, `sliding` from the first contact on."""


@dataclass(frozen=True, slots=True)
class DslParameters:
    """Constants of the lock; they travel in the policy's contract, because a policy is trained with them.

    Attributes:
        mode: `paper`: Algorithm 1. `peck`: press, feel, lift. `sliding`: contact search, then the policy owns z.
            `off`: the command is the policy's.
        delta_f: δf, changes of the normalised wrench above which an edge was felt.
        beta1: β1 of equation 3, m per unit of normalised wrench.
        beta2: β2 of equation 6, its component along z; m per m.
        force_clip_n: force that normalises to 1, N.
        torque_clip_nm: torque that normalises to 1, N·m.
        contact_threshold: normalised Fz from which there is contact.
        release_threshold: normalised Fz below which contact is lost; None: `contact_threshold`.
        seek_step_m: δz, the increment downwards while seeking, m.
        press_m: how far below the lock a command may go, m. In `peck`, how far each press goes.
        lift_max_m: how far above the first contact the lock may rise, m.
        search_depth_m: depth of one stretch of seeking without contact at which the search has failed, m.
        search_steps: length of one stretch of seeking, steps, above which the search has failed.
        peck_deeper_m: `peck` only: how much deeper the next press goes when one met nothing, m.
    """

    mode: Mode = "paper"
    delta_f: tuple[float, float, float, float, float, float] = (0.15, 0.15, 0.45, 0.1, 0.1, 0.2)
    beta1: tuple[float, float, float] = (1e-3, 1e-3, 5e-4)
    beta2: float = 1e-3
    force_clip_n: float = 10.0
    torque_clip_nm: float = 1.0
    contact_threshold: float = 0.5
    release_threshold: float | None = None
    seek_step_m: float = 5e-4
    press_m: float = 0.0
    lift_max_m: float = 5e-3
    search_depth_m: float = 0.06
    search_steps: int = 110
    peck_deeper_m: float = 5e-4

    def __post_init__(self) -> None:
        """Refuse values that no lock can work with.

        Raises:
            ValueError: the text names the field.
        """
        if self.mode not in Mode.__args__:
            raise ValueError(f"dsl.mode must be one of {', '.join(Mode.__args__)}, not {self.mode!r}")
        if len(self.delta_f) != 6 or len(self.beta1) != 3:
            raise ValueError("dsl.delta_f has 6 components and dsl.beta1 has 3")
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "mode" or value is None:
                continue
            components = np.asarray(value, np.float64)
            if not (np.isfinite(components) & (components >= 0)).all():
                raise ValueError(f"dsl.{field.name} must be finite and not negative, not {value!r}")
        for name in (
            "force_clip_n",
            "torque_clip_nm",
            "contact_threshold",
            "seek_step_m",
            "search_depth_m",
            "search_steps",
        ):
            if not getattr(self, name) > 0:
                raise ValueError(f"dsl.{name} must be above zero, not {getattr(self, name)!r}")
        if self.contact_threshold > 1:
            raise ValueError(f"dsl.contact_threshold must lie in 0 … 1 of the clip, not {self.contact_threshold!r}")
        if self.release_threshold is not None and self.release_threshold > self.contact_threshold:
            raise ValueError("dsl.release_threshold must not be above dsl.contact_threshold: the lock would chatter")
        if self.mode == "peck" and not (self.press_m > 0 and self.peck_deeper_m > 0):
            raise ValueError("dsl.press_m and dsl.peck_deeper_m must be above zero in mode peck")


@dataclass(frozen=True, slots=True)
class DslState:
    """Memory of the lock between two steps; every field has the batch shape (...) in front.

    Attributes:
        phase: (...) int32, `Phase` of the next step.
        z_lock: (...) m, the lock in force; NaN while there is none.
        z_contact0: (...) m, height of the first contact; NaN before it.
        previous_n: (..., 6) normalised wrench of the last step.
        previous_position: (..., 3) m, of the last step.
        fresh: (...) bool, True until the first step: there is no previous one to subtract.
        seek_start_z: (...) m, where this stretch of seeking began; NaN outside one.
        seek_steps: (...) int32, steps of this stretch so far.
        z_floor: (...) m, base frame, below which no command goes; constant over an episode.
    """

    phase: IntArray
    z_lock: FloatArray
    z_contact0: FloatArray
    previous_n: FloatArray
    previous_position: FloatArray
    fresh: BoolArray
    seek_start_z: FloatArray
    seek_steps: IntArray
    z_floor: FloatArray

    @classmethod
    def begin(cls, shape: tuple[int, ...] = (), z_floor: npt.ArrayLike = -inf) -> Self:
        """State before the first step.

        Args:
            shape: batch shape; () for one cell.
            z_floor: broadcastable to `shape`, m, base frame.
        """
        return cls(
            phase=np.full(shape, Phase.SEEK, np.int32),
            z_lock=np.full(shape, np.nan),
            z_contact0=np.full(shape, np.nan),
            previous_n=np.zeros((*shape, 6)),
            previous_position=np.zeros((*shape, 3)),
            fresh=np.ones(shape, np.bool_),
            seek_start_z=np.full(shape, np.nan),
            seek_steps=np.zeros(shape, np.int32),
            z_floor=np.broadcast_to(np.asarray(z_floor, np.float64), shape).copy(),
        )

    def reset(self, mask: npt.ArrayLike, z_floor: npt.ArrayLike | None = None) -> Self:
        """Forget everything where `mask` (...) is True; `z_floor`, if given, holds for those elements from now on."""
        reset_mask = np.asarray(mask, np.bool_)
        start = self.begin(np.shape(self.fresh), self.z_floor if z_floor is None else z_floor)
        merged: dict[str, Any] = {}
        for field in fields(self):
            old, new = np.asarray(getattr(self, field.name)), np.asarray(getattr(start, field.name))
            wide = reset_mask[..., None] if old.ndim > reset_mask.ndim else reset_mask
            merged[field.name] = np.where(wide, new, old)
        return type(self)(**merged)


@dataclass(frozen=True, slots=True)
class DslOutput:
    """One step's command and what led to it; base frame, batch shape (...) in front.

    Attributes:
        position: (..., 3) m, TCP target, before the command bounds.
        dyaw: (...) rad, to add to the measured yaw.
        z_lock: (...) m, the lock that held for this command; NaN while seeking or free.
        phase: (...) int32, the `Phase` that governed this command (the state holds that of the next).
        edge: (...) a jump of the wrench above δf was felt while locked.
        contact: (...) normalised Fz at or above the contact threshold.
        clamped: (...) the lock or the floor raised the z that was asked for.
        saturated: (..., 6) components of the wrench at or beyond the clip. A ceiling must judge the wrench, not the
            clipped value.
        search_depth_exceeded: (...) no contact within `search_depth_m`; the tip is held.
        search_time_exceeded: (...) no contact within `search_steps`; the tip is held.
    """

    position: FloatArray
    dyaw: FloatArray
    z_lock: FloatArray
    phase: IntArray
    edge: BoolArray
    contact: BoolArray
    clamped: BoolArray
    saturated: BoolArray
    search_depth_exceeded: BoolArray
    search_time_exceeded: BoolArray


def step(
    parameters: DslParameters,
    state: DslState,
    position: npt.ArrayLike,
    wrench: npt.ArrayLike,
    action: npt.ArrayLike,
    reset_mask: npt.ArrayLike | None = None,
) -> tuple[DslState, DslOutput]:
    """One control step of the lock.

    Args:
        parameters: the same for the whole batch.
        state: from `DslState.begin` or the last step.
        position: (..., 3) m, measured TCP.
        wrench: (..., 6) N and N·m at the TCP, base axes, zeroed and compensated, what the environment does to the tool.
        action: (..., 4) dx, dy, dz in m, dθ in rad, base frame. dz is ignored in `peck`.
        reset_mask: (...) bool, elements to reset before the step.

    Returns:
        The next state and the command. A NaN in an argument goes into both.
    """
    if reset_mask is not None:
        state = state.reset(reset_mask)
    p, w, a = (np.asarray(x, np.float64) for x in (position, wrench, action))
    z, dz = p[..., 2], a[..., 2]

    # Algorithm 1, "normalized the F/T sensor data"; Δ over one step, zero on the first
    ratio = w / np.array([parameters.force_clip_n] * 3 + [parameters.torque_clip_nm] * 3)
    n = np.clip(ratio, -1.0, 1.0)
    moved = ~state.fresh
    delta_n = (n - state.previous_n) * moved[..., None]
    delta_p = (p - state.previous_position) * moved[..., None]
    contact = n[..., 2] >= parameters.contact_threshold
    raised, edge = _lock_increment(parameters, delta_n, delta_p)

    # Algorithm 1, "while not contact": the search, its limits, and the record of the first contact
    free = parameters.mode == "off"
    seeking = (state.phase == Phase.SEEK) & (not free)
    found = seeking & contact
    searching = seeking & ~contact
    first = contact & np.isnan(state.z_contact0)
    z_contact0 = np.where(first, z, state.z_contact0)
    seek_start = np.where(searching, np.where(np.isnan(state.seek_start_z), z, state.seek_start_z), np.nan)
    seek_steps = np.where(searching, state.seek_steps + 1, 0).astype(np.int32)
    too_deep = searching & (z - parameters.seek_step_m < seek_start - parameters.search_depth_m)
    too_long = searching & (seek_steps > parameters.search_steps)
    asked_while_seeking = z - parameters.seek_step_m + (0.0 if parameters.mode == "peck" else dz)
    seek_z = np.where(too_deep | too_long, np.maximum(asked_while_seeking, z), asked_while_seeking)
    seek_z = np.fmax(seek_z, seek_start - parameters.search_depth_m)
    hold_xy = searching & np.isnan(z_contact0)

    held = ~searching
    release = parameters.contact_threshold if parameters.release_threshold is None else parameters.release_threshold
    if parameters.mode == "paper":
        # Equations 4 and 6, never above the first contact plus the lift, never below the floor
        lock = np.maximum(np.minimum(z + raised, z_contact0 + parameters.lift_max_m), state.z_floor)
        z_lock = np.where(held, lock, np.nan)
        asked = np.where(searching, seek_z, z + dz)
        command_z = np.where(held, np.maximum(asked, lock - parameters.press_m), asked)
        phase = np.where(held, Phase.LOCKED, Phase.SEEK)
        lost = held & (n[..., 2] < release)
        next_phase = np.where(lost, Phase.SEEK, phase)
        next_lock = np.where(lost, np.nan, z_lock)
        acts = held
    elif parameters.mode == "peck":
        pressing = state.phase == Phase.LOCKED
        pressed = state.phase == Phase.PRESSED
        deeper = pressed & (n[..., 2] < release)
        lift = found | (pressed & ~deeper)
        record = np.where(found, z, state.z_lock)
        # A tip that friction holds up must not let the record run away below it
        record = np.where(deeper, np.maximum(record, z) - parameters.peck_deeper_m, record)
        z_lock = np.maximum(record, state.z_floor)
        asked = np.where(searching, seek_z, np.where(lift, z_lock, z_lock - parameters.press_m))
        command_z = asked
        phase = np.where(searching, Phase.SEEK, np.where(lift, Phase.LOCKED, Phase.PRESSED))
        next_phase, next_lock = phase, z_lock
        acts = pressing | deeper
        edge = edge & pressed
    else:
        free_now = held | free
        asked = command_z = np.where(free_now, z + dz, seek_z)
        z_lock = next_lock = np.full(np.shape(z), np.nan)
        phase = next_phase = np.where(free_now, Phase.FREE, Phase.SEEK)
        acts = free_now
        edge = edge & False
    if not free:
        command_z = np.maximum(command_z, state.z_floor)

    # "x and y held until the first contact"; in `peck` also while lifting
    acts_xy = acts | (searching & ~hold_xy)
    acts_yaw = acts | searching
    command = p.copy()
    command[..., 0] += np.where(acts_xy, a[..., 0], 0.0)
    command[..., 1] += np.where(acts_xy, a[..., 1], 0.0)
    command[..., 2] = command_z
    next_state = DslState(
        phase=next_phase.astype(np.int32),
        z_lock=next_lock,
        z_contact0=z_contact0,
        previous_n=n,
        previous_position=p.copy(),
        fresh=np.zeros_like(state.fresh),
        seek_start_z=seek_start,
        seek_steps=seek_steps,
        z_floor=state.z_floor,
    )
    output = DslOutput(
        position=command,
        dyaw=np.where(acts_yaw, a[..., 3], 0.0),
        z_lock=z_lock,
        phase=phase.astype(np.int32),
        edge=edge & held,
        contact=contact,
        clamped=command_z > asked,
        saturated=np.abs(ratio) >= 1.0,
        search_depth_exceeded=too_deep,
        search_time_exceeded=too_long,
    )
    return next_state, output


def _lock_increment(
    parameters: DslParameters, delta_n: FloatArray, delta_p: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """How far above the measured z the lock stands (...), m, and whether an edge was felt (...)."""
    edge: BoolArray = np.asarray((np.abs(delta_n) > np.array(parameters.delta_f)).any(-1))
    # Equation 3, summed as in equation 4; the text says that it raises, so a negative sum does not lower
    leverage = (delta_n[..., :3] + delta_n[..., 3:]) @ np.array(parameters.beta1)
    # Equations 5 and 6
    drift = parameters.beta2 * np.sqrt((delta_p * delta_p).sum(-1))
    return np.where(edge, np.maximum(leverage, 0.0), drift), edge
