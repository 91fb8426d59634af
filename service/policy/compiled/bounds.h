/* bounds.py: the bounds on one command of one cell. */
#ifndef BOUNDS_H
#define BOUNDS_H

#include "numbers.h"

/* `BoundedCommand` */
#define BOUNDED(X) \
    X(position, NUMBER, 3) \
    X(yaw, NUMBER, 1) \
    X(invalid, TRUTH, 1) \
    X(leash, TRUTH, 1) \
    X(step, TRUTH, 1) \
    X(speed, TRUTH, 1) \
    X(workspace, TRUTH, 1) \
    X(yaw_range, TRUTH, 1) \
    X(tilt, TRUTH, 1) \
    X(excess, NUMBER, 1)

/* `BoundsParameters` */
#define BOUNDS_CONSTANTS(X) \
    X(period_s, 1) \
    X(step_m, 1) \
    X(step_rad, 1) \
    X(speed_mps, 1) \
    X(speed_radps, 1) \
    X(leash_m, 1) \
    X(leash_rad, 1) \
    X(workspace_lower, 3) \
    X(workspace_upper, 3) \
    X(yaw_centre_rad, 1) \
    X(yaw_half_range_rad, 1) \
    X(tilt_rad, 1)

typedef struct {
    BOUNDED(MEMBER)
} Bounded;

typedef struct {
    BOUNDS_CONSTANTS(CONSTANT_MEMBER)
} BoundsConstants;

/* A position, m, and a yaw, rad. */
typedef struct {
    double position[3], yaw;
} Pose;

/* `apply`; `tilt` is the measured one. */
void bounds_apply(
    const BoundsConstants *constants, Pose measured, Pose asked, const Pose *previous, double tilt, Bounded *out);

#endif
