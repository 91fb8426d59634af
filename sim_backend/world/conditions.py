"""Distributions from which an episode is drawn: the conditions that `docs/reference/conditions.md` describes.

Values that the paper does not state come from its author's code and logs. One seed draws one episode, in a fixed order,
so a seed means the same world in training, in a test and through the deployed service.
"""

from dataclasses import dataclass, replace

import numpy as np

from sim_backend.world import errors
from sim_backend.world.errors import Errors
from sim_backend.world.scene import CONTACT_TIME_S, NOMINAL_HOLE_M
from wire.arrays import CellIndices, Float32Array, FloatArray
from wire.plant import PlantErrors
from wire.records import TICK_S
from wire.task import SENSOR_DELAY_TICKS, Task

FORCE_NOISE_N = 0.7
TORQUE_NOISE_NM = 0.05
FORCE_DRIFT_N_PER_S = 0.02
TORQUE_DRIFT_NM_PER_S = 0.001
ESTIMATE_JITTER_M = 0.17e-3
FRICTION = 0.3
CONTACT_TIMES_S = (6e-3, 14e-3)
"""Smallest and largest time constant of contact of a randomised plant, s."""
LEAST_CONTACT_TIME_S = 2 * TICK_S
"""Smallest time constant of contact that MuJoCo can simulate, s."""
NOISE_ROWS = 4096
"""Ticks of sensor noise drawn per episode; an episode longer than that (8.2 s) repeats it."""
CAMERA_FRAMES = 64
"""Frames of camera jitter drawn per episode; a longer episode repeats them."""


@dataclass(frozen=True, slots=True)
class _Distributions:
    """Differences between conditions; the plant's values apply when a task does not randomise it.

    `sensor_delay`: ticks; None: it is drawn. `bias_scale`: factor on the sensor's bias.
    """

    hole_half_range_m: tuple[float, float, float] = (0.050, 0.035, 0.030)
    hole_yaw_rad: float = float(np.deg2rad(60))
    estimate_sigma_m: tuple[float, float, float] = (1.15e-3, 1.15e-3, 0.5e-3)
    grasp_sigma_m: float = 0.3e-3
    friction: float = FRICTION
    stiffness_scale: float = 1.0
    sensor_delay: int | None = None
    force_noise_n: float = FORCE_NOISE_N
    torque_noise_nm: float = TORQUE_NOISE_NM
    bias_scale: float = 1.0
    contact_time_s: float = CONTACT_TIME_S


_CONDITIONS = {
    "standard": _Distributions(),
    "easy": _Distributions((0.020, 0.020, 0.010), float(np.deg2rad(30)), (0.5e-3, 0.5e-3, 0.3e-3), 0.1e-3),
    "search": _Distributions((0.010, 0.010, 0.010)),
    "stiff": _Distributions(contact_time_s=6e-3),
    "transfer": _Distributions(
        friction=0.7,
        stiffness_scale=1.5,
        sensor_delay=SENSOR_DELAY_TICKS[1] + 1,
        force_noise_n=1.0,
        torque_noise_nm=0.07,
        bias_scale=2.0,
    ),
}


@dataclass(frozen=True, slots=True)
class Episode:
    """One draw. Lengths m, angles rad, base frame.

    Attributes:
        hole_position: (3,) centre of the mouth.
        hole_yaw: yaw relative to the matching yaw of the start pose; not observed.
        estimate_offset: (3,) constant error of the camera's estimate.
        grasp_offset: (2,) offset of the peg's axis in the tool frame.
        hover_m: height above the estimate at which the scripted approach ends.
        friction: sliding friction of peg on block.
        stiffness_scale: stiffness of the compliance law and the fingers, relative to nominal.
        mass_scale: mass of the gripper and the peg, relative to nominal.
        contact_time_s: time constant of contact (`solref`); the contact's stiffness is proportional to its inverse
            square.
        sensor_delay: ticks from force to sample: drawn from 1–4 (2–8 ms) unless the task or its conditions set it.
        target_delay: ticks from a target's arrival to its effect, without jitter.
        bias: (6,) bias of the raw sensor, N and N·m.
        drift: (6,) change of that bias per second.
        wrench_noise: (NOISE_ROWS, 6) float32, N and N·m, one row per tick.
        estimate_noise: (CAMERA_FRAMES, 3) jitter of the estimate, one row per camera frame.
        errors: further errors of the plant.
    """

    hole_position: FloatArray
    hole_yaw: float
    estimate_offset: FloatArray
    grasp_offset: FloatArray
    hover_m: float
    friction: float
    stiffness_scale: float
    mass_scale: float
    contact_time_s: float
    sensor_delay: int
    target_delay: int
    bias: FloatArray
    drift: FloatArray
    wrench_noise: Float32Array
    estimate_noise: FloatArray
    errors: Errors = errors.NONE

    @property
    def target_delays(self) -> CellIndices:
        """(JITTERS,) ticks from a target's arrival to its effect, for one target after another."""
        return self.target_delay + self.errors.target_jitter


def draw(task: Task) -> Episode:
    """Draw the episode of `task.seed` under `task.conditions`."""
    rng = np.random.default_rng(np.random.SeedSequence(task.seed))
    ranges = _CONDITIONS[task.conditions]
    half = np.array(ranges.hole_half_range_m)
    hole = np.array(NOMINAL_HOLE_M) + rng.uniform(-half, half)
    yaw = rng.uniform(-ranges.hole_yaw_rad, ranges.hole_yaw_rad)
    offset = rng.normal(0.0, ranges.estimate_sigma_m)
    grasp = rng.normal(0.0, ranges.grasp_sigma_m, 2)
    hover = rng.uniform(0.020, 0.030)
    delay = int(rng.integers(SENSOR_DELAY_TICKS[0], SENSOR_DELAY_TICKS[1] + 1))
    bias = ranges.bias_scale * rng.normal(0.0, [2.0] * 3 + [0.1] * 3)
    drift = rng.normal(0.0, [FORCE_DRIFT_N_PER_S] * 3 + [TORQUE_DRIFT_NM_PER_S] * 3)
    plant = rng.uniform(size=4)
    noise = rng.standard_normal((NOISE_ROWS, 6), np.float32)
    noise *= np.array([ranges.force_noise_n] * 3 + [ranges.torque_noise_nm] * 3, np.float32)
    jitter = rng.normal(0.0, ESTIMATE_JITTER_M, (CAMERA_FRAMES, 3))
    varied = task.randomise_plant
    if task.sensor_delay_ticks is not None:
        delay = task.sensor_delay_ticks
    elif ranges.sensor_delay is not None:
        delay = ranges.sensor_delay
    episode = Episode(
        hole_position=hole,
        hole_yaw=float(yaw),
        estimate_offset=offset,
        grasp_offset=grasp,
        hover_m=float(hover),
        friction=0.1 + 0.5 * float(plant[0]) if varied else ranges.friction,
        stiffness_scale=0.6 + 0.8 * float(plant[1]) if varied else ranges.stiffness_scale,
        mass_scale=0.8 + 0.4 * float(plant[2]) if varied else 1.0,
        contact_time_s=_contact_time(task.seed) if varied else ranges.contact_time_s,
        sensor_delay=delay,
        target_delay=int(plant[3] * 11) if varied else 2,
        bias=bias,
        drift=drift,
        wrench_noise=noise,
        estimate_noise=jitter,
    )
    return episode if task.plant is None else _disturbed(episode, task.plant, task.seed)


def _disturbed(episode: Episode, plant: PlantErrors, seed: int) -> Episode:
    """Return an episode on a plant with errors."""
    drawn = errors.directions(seed % plant.plants if plant.plants else seed)
    seen = plant.camera_error_scale * episode.estimate_offset + plant.camera_bias_m * drawn.camera
    seen[2] += plant.camera_height_m * drawn.camera_height
    return replace(
        episode,
        estimate_offset=seen,
        friction=episode.friction + plant.friction_added,
        mass_scale=episode.mass_scale * plant.payload_mass_scale,
        contact_time_s=max(episode.contact_time_s * plant.contact_time_scale, LEAST_CONTACT_TIME_S),
        sensor_delay=episode.sensor_delay + plant.ft_delay_ticks,
        target_delay=episode.target_delay + plant.target_delay_ticks,
        drift=episode.drift * plant.ft_drift_scale,
        wrench_noise=episode.wrench_noise * np.float32(plant.ft_noise_scale),
        errors=errors.errors_of(plant, drawn, seed),
    )


def _contact_time(seed: int) -> float:
    """Draw the contact time from a stream of its own, so the other draws of a seed do not depend on it."""
    return float(np.random.default_rng([seed, 2]).uniform(*CONTACT_TIMES_S))
