#include "arm.h"

#include <math.h>
#include <string.h>

#include "linear.h"
#include "quaternion.h"

/* wire/records.py */
enum { IDLE, ENGAGED, STOPPING, PROTECTIVE_STOP };
enum { FORCE_CEILING = 2, TARGET_AGE = 3, JOINT_LIMIT = 5, KINEMATICS = 6, PROTECTIVE_FORCE = 7 };

static void copy(double *to, const double *from, int count) { memcpy(to, from, (size_t)count * sizeof *to); }
static void clear(double *to, int count) { memset(to, 0, (size_t)count * sizeof *to); }

static void stop(const Arm *arm, intptr_t cell, int64_t reason)
{
    if (*integer(arm->program, cell) != ENGAGED)
        return;
    *integer(arm->program, cell) = STOPPING;
    *integer(arm->stop_reason, cell) = reason;
    *integer(arm->halted, cell) = 0;
    *integer(arm->pending, cell) = -1;
}

static void protect(const Arm *arm, intptr_t cell)
{
    if (*integer(arm->program, cell) == PROTECTIVE_STOP)
        return;
    *integer(arm->program, cell) = PROTECTIVE_STOP;
    *integer(arm->stop_reason, cell) = PROTECTIVE_FORCE;
    *integer(arm->halted, cell) = 0;
    clear(numbers(arm->reference_twist, cell), 6);
    *integer(arm->phase, cell) = 0;
}

static void release_pending(const Arm *arm, intptr_t cell)
{
    int64_t *pending = integer(arm->pending, cell);
    if (*pending == 0) {
        copy(numbers(arm->target_position, cell), numbers(arm->pending_position, cell), 3);
        copy(numbers(arm->target_quaternion, cell), numbers(arm->pending_quaternion, cell), 4);
    }
    if (*pending >= 0)
        *pending -= 1;
}

/* Stop an arm that violates a limit. Write the wrench to use, zero where it is not a number. */
static void watch(const Arm *arm, const ArmConstants *constants, const Measured *measured, intptr_t cell, double wrench[6])
{
    copy(wrench, numbers(measured->wrench, cell), 6);
    double force = length3(wrench), *peak = numbers(arm->peak_force, cell);
    *peak = fmax(*peak, force);
    *integer(arm->age, cell) += 1;
    *integer(arm->halted, cell) += 1;
    int known = isfinite(wrench[0] + wrench[1] + wrench[2] + wrench[3] + wrench[4] + wrench[5]);
    double *joints = numbers(arm->joints, cell);
    const double *seen = numbers(measured->joints, cell);
    int lagging = force >= constants->protective_force_n;
    for (int k = 0; k < 6; k++)
        lagging |= fabs(seen[k] - joints[k]) > constants->protective_error_rad;
    if (force >= *numbers(arm->ceiling, cell) || !known || *truth(measured->saturated, cell))
        stop(arm, cell, FORCE_CEILING);
    if (*integer(arm->age, cell) > *integer(arm->max_age, cell))
        stop(arm, cell, TARGET_AGE);
    if (*integer(arm->program, cell) == STOPPING && *integer(arm->halted, cell) == 1) {
        copy(numbers(arm->target_position, cell), numbers(measured->position, cell), 3);
        copy(numbers(arm->target_quaternion, cell), numbers(measured->orientation, cell), 4);
    }
    if (lagging) {
        protect(arm, cell);
        copy(joints, seen, 6);
    }
    if (!known)
        clear(wrench, 6);
}

/* Shorten a vector (3) to a length; one that is not above it stays as it is. */
static void limit(double v[3], double length)
{
    double present = length3(v);
    if (!(present > length))
        return;
    const double share = length / fmax(present, 1e-12);
    for (int k = 0; k < 3; k++)
        v[k] *= share;
}

static void step(const Arm *arm, const ArmConstants *constants, intptr_t cell)
{
    const double *twist = numbers(arm->reference_twist, cell);
    double *position = numbers(arm->reference_position, cell), half[3];
    for (int k = 0; k < 3; k++) {
        position[k] += constants->tick_s * twist[k];
        half[k] = 0.5 * constants->tick_s * twist[3 + k];
    }
    turn(numbers(arm->reference_quaternion, cell), half);
}

/* `compliance.limit_speed` */
static void limit_speed(const Arm *arm, intptr_t cell)
{
    double *twist = numbers(arm->reference_twist, cell);
    const double *max_speed = numbers(arm->max_speed, cell);
    limit(twist, max_speed[0]);
    limit(twist + 3, max_speed[1]);
}

/* `compliance.advance` */
static void advance(const Arm *arm, const ArmConstants *constants, intptr_t cell, const double wrench[6])
{
    const double *stiffness = numbers(arm->stiffness, cell), *damping = numbers(arm->damping, cell);
    const double *inertia = numbers(arm->inertia, cell), *at = numbers(arm->reference_position, cell);
    const double *target = numbers(arm->target_position, cell);
    double *twist = numbers(arm->reference_twist, cell), error[6], tick_s = constants->tick_s;
    for (int k = 0; k < 3; k++)
        error[k] = target[k] - at[k];
    rotation_between(numbers(arm->reference_quaternion, cell), numbers(arm->target_quaternion, cell), error + 3);
    for (int k = 0; k < 6; k++) {
        double force = (error[k] * stiffness[k] + wrench[k]) * tick_s;
        twist[k] = (twist[k] * inertia[k] + force) / (inertia[k] + tick_s * (damping[k] + tick_s * stiffness[k]));
    }
    limit_speed(arm, cell);
    step(arm, constants, cell);
}

/* `ArmController._follow` */
static void yield_blindly(const Arm *arm, const ArmConstants *constants, const Measured *measured, intptr_t cell)
{
    const double *seen = numbers(measured->position, cell), *at = numbers(arm->reference_position, cell);
    double *twist = numbers(arm->reference_twist, cell), offset[6];
    for (int k = 0; k < 3; k++)
        offset[k] = seen[k] - at[k];
    rotation_between(numbers(arm->reference_quaternion, cell), numbers(measured->orientation, cell), offset + 3);
    for (int k = 0; k < 6; k++)
        twist[k] += constants->follow_share * (offset[k] / constants->follow_s - twist[k]);
    limit_speed(arm, cell);
    step(arm, constants, cell);
}

static void move_reference(
    const Arm *arm, const ArmConstants *constants, const Measured *measured, intptr_t cell, const double wrench[6])
{
    int64_t *program = integer(arm->program, cell);
    if (*program == ENGAGED) {
        advance(arm, constants, cell, wrench);
    } else if (*program == STOPPING) {
        double left = fmax(1.0 - (double)*integer(arm->halted, cell) * constants->stop_share, 0.0);
        for (int k = 0; k < 2; k++)
            numbers(arm->max_speed, cell)[k] = numbers(arm->speed_limit, cell)[k] * left;
        if (*truth(arm->blind, cell))
            yield_blindly(arm, constants, measured, cell);
        else
            advance(arm, constants, cell, wrench);
        if (left == 0.0)
            *program = IDLE;
    } else {
        clear(numbers(arm->reference_twist, cell), 6);
    }
}

/* The first half of `ArmController._solve`: the Jacobian to invert and the error that its inverse takes away. */
static void linearise(const Arm *arm, const ArmConstants *constants, intptr_t cell, intptr_t number)
{
    const Lengths lengths = {
        constants->d1, constants->a2, constants->a3, constants->d4, constants->d5, constants->d6,
    };
    const double *joints = numbers(arm->joints, cell);
    double *jacobian = numbers(arm->jacobian, cell), *to_invert = numbers(arm->jacobians, number);
    double *twist = numbers(arm->reference_twist, cell), *error = numbers(arm->errors, number);
    double *at = numbers(arm->reference_position, cell), *turned = numbers(arm->reference_quaternion, cell);
    double flange[3], rotation[9], position[3], orientation[4];
    Chain chain = chain_of(&lengths, joints);
    flange_of(&lengths, &chain, flange, rotation);
    point_of(flange, rotation, constants->tcp, position);
    jacobian_of(&lengths, &chain, position, jacobian);
    copy(to_invert, jacobian, 36);
    quaternion_of(rotation, orientation);
    int singular = singularity_margin(&lengths, &chain) < constants->least_margin, outside = 0;
    for (int k = 0; k < 6; k++) {
        singular |= !(fabs(joints[k]) <= constants->angle_limit);
        outside |= fabs(joints[k]) > constants->joint_range[k];
    }
    int held = singular || *integer(arm->program, cell) == PROTECTIVE_STOP;
    if (singular) {
        stop(arm, cell, KINEMATICS);
        for (int k = 0; k < 36; k++)
            to_invert[k] = k % 7 == 0;
    }
    if (outside)
        stop(arm, cell, JOINT_LIMIT);
    if (singular || outside)
        clear(twist, 6);
    if (held) {
        copy(at, position, 3);
        copy(turned, orientation, 4);
    }
    for (int k = 0; k < 3; k++)
        error[k] = at[k] - position[k];
    rotation_between(orientation, turned, error + 3);
    for (int k = 0; k < 6; k++)
        error[k] -= constants->tick_s * twist[k]; /* `arm_follow` adds this step afterwards */
    *truth(arm->singular, cell) = (unsigned char)singular;
}

int arm_lead(const Arm *arm, const ArmConstants *constants, const Measured *measured, intptr_t cell, intptr_t number)
{
    double wrench[6];
    release_pending(arm, cell);
    watch(arm, constants, measured, cell, wrench);
    move_reference(arm, constants, measured, cell, wrench);
    int due = *integer(arm->phase, cell) == 0;
    if (due)
        linearise(arm, constants, cell, number);
    return due;
}

/* The second half of `ArmController._solve`, with `JointServo.refresh`. */
static void solve(const Arm *arm, const ArmConstants *constants, intptr_t cell, const double *inverted, const double *error)
{
    const Lengths lengths = {
        constants->d1, constants->a2, constants->a3, constants->d4, constants->d5, constants->d6,
    };
    double *inverse = numbers(arm->inverse, cell), *joints = numbers(arm->joints, cell), change[6];
    if (*truth(arm->singular, cell))
        clear(inverse, 36); /* a singular arm does not move */
    else
        copy(inverse, inverted, 36);
    product(inverse, error, change, 6);
    for (int k = 0; k < 6; k++)
        joints[k] += within(change[k], constants->joint_step[k]);
    double flange[3], rotation[9], com[3], jacobian[36];
    Chain chain = chain_of(&lengths, joints);
    flange_of(&lengths, &chain, flange, rotation);
    point_of(flange, rotation, constants->payload_com, com);
    jacobian_of(&lengths, &chain, com, jacobian);
    for (int k = 0; k < 6; k++)
        numbers(arm->sag, cell)[k] = constants->sag_per_lever[k] * jacobian[12 + k];
}

int arm_follow(
    const Arm *arm, const ArmConstants *constants, intptr_t cell, intptr_t number, const double *inverse, double out[6])
{
    int64_t *phase = integer(arm->phase, cell);
    int due = *phase == 0;
    if (due)
        solve(arm, constants, cell, inverse, numbers(arm->errors, number));
    *phase = (*phase + 1) % (int64_t)constants->kinematics_ticks;
    double *joints = numbers(arm->joints, cell), *twist = numbers(arm->reference_twist, cell), rates[6];
    const double *sag = numbers(arm->sag, cell);
    product(numbers(arm->inverse, cell), twist, rates, 6);
    int racing = 0;
    for (int k = 0; k < 6; k++)
        racing |= fabs(rates[k]) > constants->joint_speed[k];
    if (racing) {
        stop(arm, cell, KINEMATICS);
        clear(twist, 6);
        clear(rates, 6);
    }
    for (int k = 0; k < 6; k++) {
        joints[k] += constants->tick_s * rates[k];
        out[k] = joints[k] + constants->lead[k] * rates[k] + sag[k];
    }
    return due;
}
