/* arm.py, with compliance.py and servo.py: one tick of an arm controller, in two halves. */
#ifndef ARM_H
#define ARM_H

#include "kinematics.h"
#include "rows.h"

/* Attributes of `ArmController`. `errors` and `jacobians` hold the exact solutions of this tick, one after another. */
#define ARM_FIELDS(X) \
    X(program, INTEGER, 1, WRITTEN) \
    X(stop_reason, INTEGER, 1, WRITTEN) \
    X(pending, INTEGER, 1, WRITTEN) \
    X(age, INTEGER, 1, WRITTEN) \
    X(halted, INTEGER, 1, WRITTEN) \
    X(phase, INTEGER, 1, WRITTEN) \
    X(max_age, INTEGER, 1, READ) \
    X(blind, TRUTH, 1, READ) \
    X(singular, TRUTH, 1, WRITTEN) \
    X(ceiling, NUMBER, 1, READ) \
    X(peak_force, NUMBER, 1, WRITTEN) \
    X(stiffness, NUMBER, 6, READ) \
    X(damping, NUMBER, 6, READ) \
    X(inertia, NUMBER, 6, READ) \
    X(speed_limit, NUMBER, 2, READ) \
    X(max_speed, NUMBER, 2, WRITTEN) \
    X(reference_position, NUMBER, 3, WRITTEN) \
    X(reference_quaternion, NUMBER, 4, WRITTEN) \
    X(reference_twist, NUMBER, 6, WRITTEN) \
    X(target_position, NUMBER, 3, WRITTEN) \
    X(target_quaternion, NUMBER, 4, WRITTEN) \
    X(pending_position, NUMBER, 3, READ) \
    X(pending_quaternion, NUMBER, 4, READ) \
    X(joints, NUMBER, 6, WRITTEN) \
    X(jacobian, NUMBER, 36, WRITTEN) \
    X(inverse, NUMBER, 36, WRITTEN) \
    X(sag, NUMBER, 6, WRITTEN) \
    X(errors, NUMBER, 6, WRITTEN) \
    X(jacobians, NUMBER, 36, WRITTEN)

/* Measured values of a tick. */
#define MEASURED_FIELDS(X) \
    X(joints, NUMBER, 6, READ) \
    X(wrench, NUMBER, 6, READ) \
    X(position, NUMBER, 3, READ) \
    X(orientation, NUMBER, 4, READ) \
    X(saturated, TRUTH, 1, READ)

#define ARM_NUMBERS(X) \
    X(tick_s) \
    X(stop_share) \
    X(follow_s) \
    X(follow_share) \
    X(protective_force_n) \
    X(protective_error_rad) \
    X(least_margin) \
    X(angle_limit) \
    X(kinematics_ticks) \
    X(d1) \
    X(a2) \
    X(a3) \
    X(d4) \
    X(d5) \
    X(d6)

#define ARM_VECTORS(X) \
    X(joint_range, 6) \
    X(joint_speed, 6) \
    X(joint_step, 6) \
    X(tcp, 3) \
    X(payload_com, 3) \
    X(lead, 6) \
    X(sag_per_lever, 6)

typedef struct {
    ARM_FIELDS(AS_ROWS)
} Arm;

typedef struct {
    MEASURED_FIELDS(AS_ROWS)
} Measured;

typedef struct {
    ARM_NUMBERS(AS_NUMBER)
    ARM_VECTORS(AS_VECTOR)
} ArmConstants;

/* Watch the limits and advance the reference. Return 1 if an exact solution is due, which is then prepared as `number`. */
int arm_lead(const Arm *arm, const ArmConstants *constants, const Measured *measured, intptr_t cell, intptr_t number);

/* Finish the exact solution `number` with the inverse of its Jacobian, if one is due, follow the reference and write
   set-points. Return 1 if one was due. */
int arm_follow(
    const Arm *arm, const ArmConstants *constants, intptr_t cell, intptr_t number, const double *inverse, double out[6]);

#endif
