/* dsl.py: one step of the depth lock of one cell. */
#ifndef LOCK_H
#define LOCK_H

#include "numbers.h"

/* `DslState` without the floor, which is constant */
#define LOCK_STATE(X) \
    X(phase, INTEGER, 1) \
    X(z_lock, NUMBER, 1) \
    X(z_contact0, NUMBER, 1) \
    X(previous_n, NUMBER, 6) \
    X(previous_position, NUMBER, 3) \
    X(fresh, TRUTH, 1) \
    X(seek_start_z, NUMBER, 1) \
    X(seek_steps, INTEGER, 1)

/* `DslOutput` */
#define LOCK_OUTPUT(X) \
    X(position, NUMBER, 3) \
    X(dyaw, NUMBER, 1) \
    X(z_lock, NUMBER, 1) \
    X(phase, INTEGER, 1) \
    X(edge, TRUTH, 1) \
    X(contact, TRUTH, 1) \
    X(clamped, TRUTH, 1) \
    X(saturated, TRUTH, 6) \
    X(search_depth_exceeded, TRUTH, 1) \
    X(search_time_exceeded, TRUTH, 1)

/* `DslParameters`; `mode` by its place in `LockMode`, `clip` per component, `release_threshold` never None */
#define LOCK_CONSTANTS(X) \
    X(mode, 1) \
    X(delta_f, 6) \
    X(beta1, 3) \
    X(beta2, 1) \
    X(clip, 6) \
    X(contact_threshold, 1) \
    X(release_threshold, 1) \
    X(seek_step_m, 1) \
    X(press_m, 1) \
    X(lift_max_m, 1) \
    X(search_depth_m, 1) \
    X(search_steps, 1)

typedef struct {
    LOCK_STATE(MEMBER)
} LockState;

typedef struct {
    LOCK_OUTPUT(MEMBER)
} LockOutput;

typedef struct {
    LOCK_CONSTANTS(CONSTANT_MEMBER)
} LockConstants;

enum { PAPER, SLIDING, OFF }; /* `LockMode` */
enum { SEEK = 0, LOCKED = 1, FREE = 3 }; /* `Phase` */

/* `_Felt`, and "if Δn > δf" of Algorithm 1 */
typedef struct {
    double n[6], delta_n[6], delta_p[3];
    int contact, edge;
    unsigned char saturated[6];
} Felt;

/* `_feel`: normalise the wrench and take the changes over one step. */
Felt lock_feel(const LockConstants *constants, const LockState *state, const double p[3], const double w[6]);

/* The rest of `step`. `increment` is the sum of equation 3; `action` is dx, dy, dz, dyaw. */
void lock_step(
    const LockConstants *constants, LockState *state, double z_floor, const Felt *felt, double increment,
    const double p[3], const double action[4], LockOutput *out);

#endif
