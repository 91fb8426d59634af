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


class Phase(IntEnum):
    """What governs a command."""

    SEEK = 0
    """No contact: creep down."""
    LOCKED = 1
    """In contact: z may not go below the lock."""
    FREE = 3
    """The policy owns z: `off` always, `sliding` from the first contact on."""


@dataclass(frozen=True, slots=True)
class DslParameters:
    """Constants of the lock. They are stored in the policy's contract, because a policy is trained with them.

    Attributes:
        mode: `paper`: Algorithm 1. `sliding`: the search for contact, then the policy owns z. `off`: the policy's
            command as it is.
        delta_f: δf, changes of the normalised wrench above which an edge was felt.
        beta1: β1 of equation 3, m per unit of normalised wrench.
        beta2: β2 of equation 6, its component along z; m per m.
        force_clip_n: force that normalises to 1, N.
        torque_clip_nm: torque that normalises to 1, N·m.
        contact_threshold: normalised Fz from which there is contact.
        release_threshold: normalised Fz below which contact is lost; None: `contact_threshold`.
        seek_step_m: δz, the increment downwards while seeking, m.
        press_m: how far below the lock a command may go, m.
        lift_max_m: how far above the first contact the lock may rise, m.
        search_depth_m: depth of one stretch of seeking without contact at which the search has failed, m.
        search_steps: length of one stretch of seeking, steps, above which the search has failed.
    """

    mode: LockMode = "paper"
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

    def __post_init__(self) -> None:
        """Refuse values that no lock can work with.

        Raises:
            ValueError: the text names the field.
        """
        if self.mode not in LockMode.__args__:
            raise ValueError(f"dsl.mode must be one of {', '.join(LockMode.__args__)}, not {self.mode!r}")
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
        action: (..., 4) dx, dy, dz in m, dθ in rad, base frame.
        reset_mask: (...) bool, elements to reset before the step.

    Returns:
        The next state and the command. A NaN in an argument goes into both.
    """
    if reset_mask is not None:
        state = state.reset(reset_mask)
    p, w, a = (np.asarray(x, np.float64) for x in (position, wrench, action))
    felt = _feel(parameters, state, p, w)
    search = _search(parameters, state, felt, p[..., 2], a[..., 2])
    z = _MODES[parameters.mode](parameters, state, felt, search, p, a[..., 2])

    # Algorithm 1 holds x and y until the first contact
    moves_xy = ~search.under_way | np.isfinite(search.z_contact0)
    command = p.copy()
    command[..., 0] += np.where(moves_xy, a[..., 0], 0.0)
    command[..., 1] += np.where(moves_xy, a[..., 1], 0.0)
    command[..., 2] = z.command
    next_state = DslState(
        phase=z.next_phase.astype(np.int32),
        z_lock=z.next_lock,
        z_contact0=search.z_contact0,
        previous_n=felt.n,
        previous_position=p.copy(),
        fresh=np.zeros_like(state.fresh),
        seek_start_z=search.start_z,
        seek_steps=search.steps,
        z_floor=state.z_floor,
    )
    output = DslOutput(
        position=command,
        dyaw=a[..., 3].copy(),
        z_lock=z.lock,
        phase=z.phase.astype(np.int32),
        edge=z.edge,
        contact=felt.contact,
        clamped=z.command > z.asked,
        saturated=felt.saturated,
        search_depth_exceeded=search.too_deep,
        search_time_exceeded=search.too_long,
    )
    return next_state, output


# --- what every mode begins with


@dataclass(frozen=True, slots=True)
class _Felt:
    """The wrench of one step, normalised, and what has changed since the last step.

    Attributes:
        n: (..., 6) normalised wrench.
        delta_n: (..., 6) its change; zero on the first step.
        delta_p: (..., 3) m, displacement of the TCP; zero on the first step.
        contact: (...) normalised Fz at or above the contact threshold.
        saturated: (..., 6) components at or beyond the clip.
    """

    n: FloatArray
    delta_n: FloatArray
    delta_p: FloatArray
    contact: BoolArray
    saturated: BoolArray


def _feel(parameters: DslParameters, state: DslState, p: FloatArray, w: FloatArray) -> _Felt:
    """Algorithm 1, "normalized the F/T sensor data", and Δ over one step."""
    ratio = w / np.array([parameters.force_clip_n] * 3 + [parameters.torque_clip_nm] * 3)
    n = np.clip(ratio, -1.0, 1.0)
    moved = ~state.fresh
    return _Felt(
        n=n,
        delta_n=(n - state.previous_n) * moved[..., None],
        delta_p=(p - state.previous_position) * moved[..., None],
        contact=n[..., 2] >= parameters.contact_threshold,
        saturated=np.abs(ratio) >= 1.0,
    )


@dataclass(frozen=True, slots=True)
class _Search:
    """The search for contact after one step.

    Attributes:
        under_way: (...) there is no contact and the tip creeps down.
        z_contact0: (...) m, height of the first contact; NaN before it.
        start_z: (...) m, where this stretch of the search began; NaN outside one.
        steps: (...) int32, steps of this stretch.
        too_deep: (...) the stretch has reached `search_depth_m`; the tip is held.
        too_long: (...) the stretch has reached `search_steps`; the tip is held.
        command: (...) m, height commanded while the search is under way.
    """

    under_way: BoolArray
    z_contact0: FloatArray
    start_z: FloatArray
    steps: IntArray
    too_deep: BoolArray
    too_long: BoolArray
    command: FloatArray


def _search(parameters: DslParameters, state: DslState, felt: _Felt, z: FloatArray, dz: FloatArray) -> _Search:
    """Algorithm 1, "while not contact": creep down by δz and the policy's dz, bounded in depth and time."""
    seeking = (state.phase == Phase.SEEK) & (parameters.mode != "off")
    under_way = seeking & ~felt.contact
    first = felt.contact & np.isnan(state.z_contact0)
    start_z = np.where(under_way, np.where(np.isnan(state.seek_start_z), z, state.seek_start_z), np.nan)
    steps = np.where(under_way, state.seek_steps + 1, 0).astype(np.int32)
    too_deep = under_way & (z - parameters.seek_step_m < start_z - parameters.search_depth_m)
    too_long = under_way & (steps > parameters.search_steps)
    asked = z - parameters.seek_step_m + dz
    command = np.where(too_deep | too_long, np.maximum(asked, z), asked)
    return _Search(
        under_way=under_way,
        z_contact0=np.where(first, z, state.z_contact0),
        start_z=start_z,
        steps=steps,
        too_deep=too_deep,
        too_long=too_long,
        command=np.fmax(command, start_z - parameters.search_depth_m),
    )


# --- the modes


@dataclass(frozen=True, slots=True)
class _Height:
    """What a mode decides about z; batch shape (...).

    Attributes:
        asked: m, height asked for.
        command: m, height commanded.
        lock: m, the lock that holds for this command; NaN without one.
        next_lock: m, the lock that the next step begins with.
        phase: `Phase` that governs this command.
        next_phase: `Phase` that the next step begins in.
        edge: a jump of the wrench above δf was felt while locked.
    """

    asked: FloatArray
    command: FloatArray
    lock: FloatArray
    next_lock: FloatArray
    phase: npt.NDArray[np.integer]
    next_phase: npt.NDArray[np.integer]
    edge: BoolArray


def _paper(
    parameters: DslParameters, state: DslState, felt: _Felt, search: _Search, p: FloatArray, dz: FloatArray
) -> _Height:
    """Algorithm 1: seek until contact; in contact hold z above the lock, which an edge raises."""
    z = p[..., 2]
    locked = ~search.under_way
    # "if Δn > δf": an edge was felt
    edge: BoolArray = np.asarray((np.abs(felt.delta_n) > np.array(parameters.delta_f)).any(-1))
    # Equation 3, summed as in equation 4. The increment raises, so a negative sum does not lower the lock
    raised = np.maximum((felt.delta_n[..., :3] + felt.delta_n[..., 3:]) @ np.array(parameters.beta1), 0.0)
    # Equations 5 and 6: without an edge the lock stays at the tip, but for a drift of about a micrometre
    drift = parameters.beta2 * np.sqrt((felt.delta_p * felt.delta_p).sum(-1))
    # Bounds that the paper leaves open: never above the first contact plus the lift, never below the floor
    highest = search.z_contact0 + parameters.lift_max_m
    lock = np.maximum(np.minimum(z + np.where(edge, raised, drift), highest), state.z_floor)
    # "z ≥ z_lock"
    asked = np.where(locked, z + dz, search.command)
    command = np.where(locked, np.maximum(asked, lock - parameters.press_m), asked)
    # "while not contact" again: a lost contact releases the lock
    release = parameters.contact_threshold if parameters.release_threshold is None else parameters.release_threshold
    lost = locked & (felt.n[..., 2] < release)
    z_lock = np.where(locked, lock, np.nan)
    phase = np.where(locked, Phase.LOCKED, Phase.SEEK)
    return _Height(
        asked=asked,
        command=np.maximum(command, state.z_floor),
        lock=z_lock,
        next_lock=np.where(lost, np.nan, z_lock),
        phase=phase,
        next_phase=np.where(lost, Phase.SEEK, phase),
        edge=edge & locked,
    )


def _sliding(
    parameters: DslParameters, state: DslState, felt: _Felt, search: _Search, p: FloatArray, dz: FloatArray
) -> _Height:
    """The same search for contact, without a lock after it: the policy owns z."""
    asked = np.where(search.under_way, search.command, p[..., 2] + dz)
    phase = np.where(search.under_way, Phase.SEEK, Phase.FREE)
    return _unlocked(asked, np.maximum(asked, state.z_floor), phase)


def _off(
    parameters: DslParameters, state: DslState, felt: _Felt, search: _Search, p: FloatArray, dz: FloatArray
) -> _Height:
    """The policy owns z from the first step on."""
    asked = p[..., 2] + dz
    return _unlocked(asked, asked, np.full(np.shape(asked), Phase.FREE))


def _unlocked(asked: FloatArray, command: FloatArray, phase: npt.NDArray[np.integer]) -> _Height:
    no_lock = np.full(np.shape(asked), np.nan)
    no_edge = np.zeros(np.shape(asked), np.bool_)
    return _Height(asked, command, no_lock, no_lock, phase, phase, no_edge)


_MODES = {"paper": _paper, "sliding": _sliding, "off": _off}
