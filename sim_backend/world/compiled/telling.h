/* telling.py: what cells tell of themselves. */
#ifndef TELLING_H
#define TELLING_H

#include "rows.h"

#define TELLING_FIELDS(X) \
    X(joints, NUMBER, 6, READ) \
    X(qvel, NUMBER, AT_LEAST(6), READ) \
    X(position, NUMBER, 3, READ) \
    X(rotation, NUMBER, 9, READ) \
    X(estimate, NUMBER, 3, READ) \
    X(jacobian, NUMBER, 36, READ) \
    X(target_position, NUMBER, 3, READ) \
    X(target_quaternion, NUMBER, 4, READ) \
    X(peak_force, NUMBER, 1, READ) \
    X(wrench, NUMBER, 6, READ) \
    X(raw, NUMBER, 6, READ)

/* `REPORT` */
#define REPORT_FIELDS(X) \
    X(q, NUMBER, 6, WRITTEN) \
    X(qd, NUMBER, 6, WRITTEN) \
    X(tcp_position, NUMBER, 3, WRITTEN) \
    X(tcp_rotvec, NUMBER, 3, WRITTEN) \
    X(tcp_velocity, NUMBER, 6, WRITTEN) \
    X(target_position, NUMBER, 3, WRITTEN) \
    X(target_rotvec, NUMBER, 3, WRITTEN) \
    X(wrench, NUMBER, 6, WRITTEN) \
    X(ft_raw, NUMBER, 6, WRITTEN) \
    X(hole_estimate, NUMBER, 3, WRITTEN) \
    X(peak_force, NUMBER, 1, WRITTEN)

typedef struct {
    TELLING_FIELDS(AS_ROWS)
} Telling;

typedef struct {
    REPORT_FIELDS(AS_ROWS)
} Report;

void telling_fill(const Telling *telling, const Report *report, intptr_t n);

#endif
