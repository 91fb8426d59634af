/* joint_sense.py: one reading of the drives of n arms. */
#ifndef JOINT_SENSE_H
#define JOINT_SENSE_H

#include "kinematics.h"
#include "rows.h"

/* Attributes of `JointSense`. */
#define DRIVES_FIELDS(X) \
    X(stick, NUMBER, 6, WRITTEN) \
    X(force, NUMBER, 3, WRITTEN)

/* What the drives are made to do: `World.drives`, and noise of unit variance. */
#define EFFORT_FIELDS(X) \
    X(joints, NUMBER, 6, READ) \
    X(speeds, NUMBER, AT_LEAST(6), READ) \
    X(servo, NUMBER, 6, READ) \
    X(constraint, NUMBER, AT_LEAST(6), READ) \
    X(passive, NUMBER, AT_LEAST(6), READ) \
    X(bias, NUMBER, AT_LEAST(6), READ) \
    X(noise, NUMBER, 6, READ)

#define DRIVES_NUMBERS(X) \
    X(turns_per_rad_s) \
    X(modelled_share) \
    X(weight) \
    X(d1) \
    X(a2) \
    X(a3) \
    X(d4) \
    X(d5) \
    X(d6)

#define DRIVES_VECTORS(X) \
    X(friction, 6) \
    X(noise_nm, 6) \
    X(trust, 6) \
    X(com, 3) \
    X(point, 3)

typedef struct {
    DRIVES_FIELDS(AS_ROWS)
} Drives;

typedef struct {
    EFFORT_FIELDS(AS_ROWS)
} Effort;

typedef struct {
    DRIVES_NUMBERS(AS_NUMBER)
    DRIVES_VECTORS(AS_VECTOR)
} DrivesConstants;

void drives_read(const Drives *drives, const DrivesConstants *constants, const Effort *effort, intptr_t n);

#endif
