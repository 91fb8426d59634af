"""Limits that no run may exceed, requirements before the arm moves, and agreement of the sensor with the joints."""

from typing import Annotated

from service.config.fields import Box, Force, Section, Torque, count, number
from wire.impact import CONTACT_N_M
from wire.limits import MAX_SPEED, MAX_STEP, TARGET_AGE_S, TILT_RAD, TORQUE_CEILING_NM, YAW_HALF_RANGE_RAD

Stiffness = Annotated[float, number(10.0, 5000.0, "the tool sags; softer than the arm itself, which has 7500 N/m")]
Twist = Annotated[float, number(0.1, 200.0, "the tool sags; softer than the arm itself, which has 550 N·m/rad")]
Damping = Annotated[float, number(1.0, 5000.0, "any law swings; the arm hardly yields")]
TurnDamping = Annotated[float, number(0.01, 20.0, "any law swings; the arm hardly yields")]
Mass = Annotated[float, number(0.1, 20.0, "lighter than a gripper: noise moves the arm; a blow instead of a touch")]
Inertia = Annotated[float, number(1e-3, 0.5, "lighter than a gripper: noise moves the arm; a blow instead of a touch")]
HoleOffset = Annotated[float, number(1e-4, 0.2, "the camera's own jitter; any place within reach")]
SixStiffness = tuple[Stiffness, Stiffness, Stiffness, Twist, Twist, Twist]
SixDamping = tuple[Damping, Damping, Damping, TurnDamping, TurnDamping, TurnDamping]
SixInertia = tuple[Mass, Mass, Mass, Inertia, Inertia, Inertia]


class LimitsSection(Section):
    """Limits that no run may exceed.

    Attributes:
        force_ceiling_n: largest resultant force of any single sample, N.
        torque_ceiling_nm: largest resultant torque at the TCP of any single sample, N·m.
        sample_age_s: age of the newest sample, and gap between two, at which the cell latches STALE.
        stuck_samples: samples in a row, bit-identical in all forces or all torques, at which the cell latches
            SENSOR_STUCK.
        stuck_channel_samples: the same for one channel. A sensor that is quantised more coarsely than its noise needs
            more.
        target_age_s: time without a target after which the arm's own controller stops.
        max_step_m: largest change between two targets, and largest distance of a target from the measured position.
        max_turn_rad: the same for the yaw.
        max_speed_m_s: largest speed of targets and of the arm's reference.
        max_turn_speed_rad_s: the same for the yaw.
        max_tilt_rad: largest tilt of the tool from straight down.
        max_stiffness: N/m and N·m/rad. A policy that wants more is refused.
        min_damping: N·s/m and N·m·s/rad. A policy that wants less is refused: the arm would swing.
        max_damping: a policy that wants more is refused: the arm would hardly yield.
        min_inertia: kg and kg·m². A policy that wants less is refused, for the same reason.
        max_inertia: a policy that wants more is refused: an impact would be hard.
        max_press_m: how far a policy's lock may press below the height of a contact.
        max_contact_share: largest `dsl.contact_threshold` of a policy's clips, as a share of force ceiling and torque
            ceiling: the lock must feel a contact long before the cell stops for it.
        max_seek_step_m: largest step downwards of a policy's lock while it seeks.
        max_lift_m: largest height above the first contact to which a policy's lock may rise.
        max_search_depth_m: largest depth of one stretch of a policy's search for contact.
        max_search_steps: largest length of one, policy steps.
        max_hole_offset_m: largest distance of the camera's estimate of the hole from the nominal one, per axis;
            beyond it the run fails before any motion.
        workspace_m: lower and upper corner of the box in which the TCP stays, base frame.
        yaw_range_rad: largest turn from the start yaw, either way.
        clamped_steps: outrageous policy steps in a row before the cell latches BOUNDS.
        stop_confirm_s: time in which standstill must be measured after a stop.
        policy_deadline_s: time of one inference at which the cell latches POLICY_DEADLINE.
        contact_n_m: stiffness of the stiffest thing that the tool may meet, N/m: tool, part and fixture in series. The
            speed of approach and search is limited by the blow that it would give.
    """

    force_ceiling_n: Force
    torque_ceiling_nm: Torque = TORQUE_CEILING_NM
    sample_age_s: Annotated[float, number(0.006, 0.5, "three samples; half a second blind")] = 0.05
    stuck_samples: Annotated[int, count(2, 100, "one sample repeats nothing; 0.2 s blind")] = 10
    stuck_channel_samples: Annotated[int, count(2, 200, "one sample repeats nothing; 0.4 s blind")] = 25
    target_age_s: Annotated[float, number(0.02, 1.0, "transport alone; a second without a host")] = TARGET_AGE_S
    max_step_m: Annotated[float, number(1e-4, 0.05, "the arm hardly moves; a jump")] = MAX_STEP[0]
    max_turn_rad: Annotated[float, number(1e-3, 0.5, "the arm hardly turns; a jump")] = MAX_STEP[1]
    max_speed_m_s: Annotated[float, number(1e-3, 0.25, "the arm hardly moves; speed beside people")] = MAX_SPEED[0]
    max_turn_speed_rad_s: Annotated[float, number(0.01, 3.0, "the arm hardly turns; a joint's speed")] = MAX_SPEED[1]
    max_tilt_rad: Annotated[float, number(5e-3, 0.5, "sensor noise; a tool that leans by 29 degrees")] = TILT_RAD
    max_stiffness: SixStiffness = (3000.0, 3000.0, 3000.0, 100.0, 100.0, 100.0)
    min_damping: SixDamping = (60.0, 60.0, 60.0, 0.1, 0.1, 0.1)
    max_damping: SixDamping = (2000.0, 2000.0, 2000.0, 5.0, 5.0, 5.0)
    min_inertia: SixInertia = (0.5, 0.5, 0.5, 0.01, 0.01, 0.005)
    max_inertia: SixInertia = (10.0, 10.0, 10.0, 0.2, 0.2, 0.2)
    max_press_m: Annotated[float, number(1e-5, 0.02, "less than the position's noise; no lock at all")] = 5e-3
    max_contact_share: Annotated[float, number(0.01, 0.8, "noise is contact; the ceiling comes first")] = 1.0 / 3.0
    max_seek_step_m: Annotated[float, number(1e-5, 0.02, "the tip hardly sinks; a blow instead of a touch")] = 5e-3
    max_lift_m: Annotated[float, number(1e-4, 0.05, "no lift; out of the approach's height")] = 0.01
    max_search_depth_m: Annotated[float, number(1e-3, 0.2, "no search; through the table")] = 0.1
    max_search_steps: Annotated[int, count(1, 2000, "no search; minutes without contact")] = 200
    max_hole_offset_m: tuple[HoleOffset, HoleOffset, HoleOffset] = (0.08, 0.06, 0.05)
    workspace_m: Box
    yaw_range_rad: Annotated[float, number(0.01, 3.14159, "no turn; every yaw")] = YAW_HALF_RANGE_RAD
    clamped_steps: Annotated[int, count(1, 20, "the first one latches; two seconds of outrageous steps")] = 5
    stop_confirm_s: Annotated[float, number(0.05, 2.0, "shorter than a stop; longer than anybody waits")] = 0.5
    policy_deadline_s: Annotated[float, number(0.005, 0.5, "no inference is that fast; half a second held")] = 0.12
    contact_n_m: Annotated[float, number(1e3, 1e6, "softer than a rubber foot; steel on steel")] = CONTACT_N_M


class PreflightSection(Section):
    """Requirements on sensor and pose before the arm moves; `service/safety/preflight.py` checks them.

    Attributes:
        window_samples: number of samples that are judged.
        contact_force_n: mean resultant force that means that something touches the tool.
        bias_force_n: largest mean resultant force after zeroing.
        bias_torque_nm: the same for torque.
        noise_force_n: largest standard deviation of a component.
        noise_torque_nm: the same for torque.
        position_m: largest distance from the start position.
        yaw_rad: largest turn from the start yaw.
        tilt_rad: largest tilt.
        unzeroed_force_n: mean resultant force before zeroing that means that something loads the tool.
        unzeroed_torque_nm: the same for torque.
    """

    window_samples: Annotated[int, count(10, 1000, "a mean needs ten; 2 s of standing")] = 100
    contact_force_n: Annotated[float, number(0.5, 10.0, "noise; a pressed tool")] = 3.0
    bias_force_n: Annotated[float, number(0.1, 5.0, "noise; a touched tool")] = 1.5
    bias_torque_nm: Annotated[float, number(0.01, 1.0, "noise; a touched tool")] = 0.3
    noise_force_n: Annotated[float, number(0.05, 5.0, "quieter than any sensor; louder than a contact")] = 1.5
    noise_torque_nm: Annotated[float, number(0.01, 1.5, "quieter than any sensor; louder than a contact")] = 0.4
    position_m: Annotated[float, number(1e-4, 0.02, "less than the arm repeats; another pose")] = 5e-3
    yaw_rad: Annotated[float, number(1e-3, 0.2, "less than the arm repeats; another pose")] = 0.05
    tilt_rad: Annotated[float, number(1e-3, 0.1, "less than the arm repeats; another pose")] = 0.02
    unzeroed_force_n: Annotated[float, number(1.0, 30.0, "the sensor's own bias; a pressed tool")] = 12.0
    unzeroed_torque_nm: Annotated[float, number(0.1, 5.0, "the sensor's own bias; a pressed tool")] = 2.5


class WitnessSection(Section):
    """Agreement of the force/torque sensor with the arm's joints, for an arm that gives their forces.

    `service/safety/witness.py` compares them.

    Attributes:
        force_n: difference of their forces at which the cell latches SENSOR_INVALID.
        time_s: time constant of the mean over which they are compared.
        rest_force_n: largest force that the joints may feel before a run, with the configured payload and a free tool.
    """

    force_n: Annotated[float, number(1.0, 30.0, "the joints' own friction; a whole ceiling apart")] = 12.0
    time_s: Annotated[float, number(0.002, 0.1, "one sample; longer than a blow lasts")] = 0.02
    rest_force_n: Annotated[float, number(1.0, 30.0, "the joints' own friction; a pressed tool")] = 6.0
