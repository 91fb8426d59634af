"""The dynamic safety lock (DSL): limits the depth that a policy may command, depending on the contact.

It implements Algorithm 1 and equations 3 to 6 of the paper "DSL-Assembly: A Robust and Safe Assembly Strategy" (Y. Liu)
for any batch shape. Comments name the line or equation that the code below them implements.

Frames and signs are those of `docs/reference/frames.md`: base frame, z up, insertion along -z, pressing gives Fz > 0.

Arguments must not contain NaN: it would enter the lock's state and stay there. Nothing here checks this, because the
lock also runs over thousands of simulated cells. In a cell, the monitor refuses NaN before the lock and the bounds
refuse it after the lock.
"""

from dataclasses import dataclass, fields
from enum import IntEnum
from math import inf
from typing import Self

import numpy as np
import numpy.typing as npt

from wire.arrays import BoolArray, FloatArray, IntArray
from wire.modes import LockMode


class Phase(IntEnum):
    """Rule that decides the z of a command."""

    SEEK = 0
    """No contact: creep down in search of it."""
    LOCKED = 1
    """In contact: z may not go below the lock."""
    FREE = 3  # 2 was the phase of a mode that is gone; trained policies observe this number, so it stays
    """The policy commands z: always in mode `off`, from the first contact on in mode `sliding`."""


@dataclass(frozen=True, slots=True)
class DslParameters:
    """Constants of the lock. They are stored in the policy's contract, because a policy is trained with them.

    Attributes:
        mode: `paper`: Algorithm 1. `sliding`: search for contact, then the policy commands z. `off`: the policy's
            command passes unchanged.
        delta_f: δf, change of each component of the normalised wrench above which an edge is detected.
        beta1: β1 of equation 3, m per unit of normalised wrench.
        beta2: β2 of equation 6, its component along z; m per m.
        force_clip_n: force that normalises to 1, N.
        torque_clip_nm: torque that normalises to 1, N·m.
        contact_threshold: normalised Fz from which there is contact.
        release_threshold: normalised Fz below which contact is lost; None: `contact_threshold`.
        seek_step_m: δz, downward increment per step of a search, m.
        press_m: largest distance that a command may go below the lock, m.
        lift_max_m: largest distance that the lock may rise above the first contact, m.
        search_depth_m: depth of one search without contact at which it has failed, m.
        search_steps: number of steps of one search above which it has failed.
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
            ValueError: a field is out of range; the text names it.
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
        previous_position: (..., 3) m, measured TCP of the last step.
        fresh: (...) bool, True until the first step, which has no previous one to subtract.
        seek_start_z: (...) m, height at which the present search began; NaN outside a search.
        seek_steps: (...) int32, steps of the present search so far.
        z_floor: (...) m, base frame, lowest commanded height in modes `paper` and `sliding`; constant over an episode.
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
        """Return the state before the first step.

        Args:
            shape: batch shape; () for one cell.
            z_floor: lowest commanded height, broadcastable to `shape`, m, base frame.
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


@dataclass(frozen=True, slots=True)
class DslOutput:
    """Command of one step, with the decisions behind it; base frame, batch shape (...) in front.

    Attributes:
        position: (..., 3) m, TCP target, before the command bounds.
        dyaw: (...) rad, to add to the measured yaw.
        z_lock: (...) m, height of the lock for this command; NaN while seeking or free.
        phase: (...) int32, `Phase` of this command (the state holds the phase of the next one).
        edge: (...) True where the wrench jumped by more than δf while locked.
        contact: (...) True where normalised Fz is at or above the contact threshold.
        clamped: (...) True where the lock or the floor raised the requested z.
        saturated: (..., 6) True for components of the wrench at or beyond the clip. A ceiling must judge the wrench,
            not the clipped value.
        search_depth_exceeded: (...) True where there was no contact within `search_depth_m`; the tip is held.
        search_time_exceeded: (...) True where there was no contact within `search_steps`; the tip is held.
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
) -> tuple[DslState, DslOutput]:
    """Run one control step of the lock.

    Args:
        parameters: constants, the same for the whole batch.
        state: from `DslState.begin` or the last step.
        position: (..., 3) m, measured TCP.
        wrench: (..., 6) N and N·m at the TCP, base axes, zeroed and compensated: the environment's action on the tool.
        action: (..., 4) dx, dy, dz in m, dθ in rad, base frame.

    Returns:
        The next state and the command. A NaN in an argument passes into both.
    """
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


# --- common to all modes


@dataclass(frozen=True, slots=True)
class _Felt:
    """The normalised wrench of one step, and the changes since the last step.

    Attributes:
        n: (..., 6) normalised wrench.
        delta_n: (..., 6) its change; zero on the first step.
        delta_p: (..., 3) m, displacement of the TCP; zero on the first step.
        contact: (...) True where normalised Fz is at or above the contact threshold.
        saturated: (..., 6) True for components at or beyond the clip.
    """

    n: FloatArray
    delta_n: FloatArray
    delta_p: FloatArray
    contact: BoolArray
    saturated: BoolArray


def _feel(parameters: DslParameters, state: DslState, p: FloatArray, w: FloatArray) -> _Felt:
    """Normalise the wrench (Algorithm 1, "normalized the F/T sensor data") and take Δ over one step."""
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
        under_way: (...) True while there is no contact and the tip creeps down.
        z_contact0: (...) m, height of the first contact; NaN before it.
        start_z: (...) m, height at which the present search began; NaN outside a search.
        steps: (...) int32, steps of the present search.
        too_deep: (...) True where the search would go beyond `search_depth_m`; the tip is held.
        too_long: (...) True where the search has lasted longer than `search_steps`; the tip is held.
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
    """Search for contact (Algorithm 1, "while not contact"): creep down by δz plus the policy's dz, within bounds."""
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
    """Decision of a mode about z; batch shape (...).

    Attributes:
        asked: m, height requested.
        command: m, height commanded.
        lock: m, height of the lock for this command; NaN without one.
        next_lock: m, height of the lock at the beginning of the next step.
        phase: `Phase` of this command.
        next_phase: `Phase` at the beginning of the next step.
        edge: True where the wrench jumped by more than δf while locked.
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
    """Algorithm 1: seek until contact, then keep z above the lock. An edge raises the lock."""
    z = p[..., 2]
    locked = ~search.under_way
    # "if Δn > δf": an edge was felt
    edge: BoolArray = np.asarray((np.abs(felt.delta_n) > np.array(parameters.delta_f)).any(-1))
    # Equation 3, summed as in equation 4. The increment only raises: a negative sum does not lower the lock
    raised = np.maximum((felt.delta_n[..., :3] + felt.delta_n[..., 3:]) @ np.array(parameters.beta1), 0.0)
    # Equations 5 and 6: without an edge the lock is at the tip, plus a drift of about a micrometre
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
    """Search for contact as in `paper`, then let the policy command z without a lock."""
    asked = np.where(search.under_way, search.command, p[..., 2] + dz)
    phase = np.where(search.under_way, Phase.SEEK, Phase.FREE)
    return _unlocked(asked, np.maximum(asked, state.z_floor), phase)


def _off(
    parameters: DslParameters, state: DslState, felt: _Felt, search: _Search, p: FloatArray, dz: FloatArray
) -> _Height:
    """Let the policy command z from the first step on."""
    asked = p[..., 2] + dz
    return _unlocked(asked, asked, np.full(np.shape(asked), Phase.FREE))


def _unlocked(asked: FloatArray, command: FloatArray, phase: npt.NDArray[np.integer]) -> _Height:
    no_lock = np.full(np.shape(asked), np.nan)
    no_edge = np.zeros(np.shape(asked), np.bool_)
    return _Height(asked, command, no_lock, no_lock, phase, phase, no_edge)


_MODES = {"paper": _paper, "sliding": _sliding, "off": _off}
