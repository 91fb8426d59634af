/* observation.py: one observation of one cell. */
#ifndef OBSERVATION_H
#define OBSERVATION_H

#include "numbers.h"
#include "window.h"

/* `ObservationState` without the frames */
#define MEMORY(X) \
    X(hole_mean, NUMBER, 3) \
    X(hole_count, INTEGER, 1) \
    X(steps, INTEGER, 1)

/* `Measurement` without the window */
#define MEASUREMENT(X) \
    X(position, NUMBER, 3) \
    X(yaw, NUMBER, 1) \
    X(tilt, NUMBER, 2) \
    X(hole_estimate, NUMBER, 3) \
    X(nominal_hole, NUMBER, 3) \
    X(target_position, NUMBER, 3) \
    X(target_yaw, NUMBER, 1) \
    X(start_yaw, NUMBER, 1) \
    X(z_lock, NUMBER, 1) \
    X(contact_z, NUMBER, 1) \
    X(phase, INTEGER, 1) \
    X(previous_action, NUMBER, 4) \
    X(last_joint, NUMBER, 1)

/* `uses_nominal`: mode FTM; `feels_nothing`: mode VM */
#define OBSERVATION_CONSTANTS(X) \
    X(uses_nominal, 1) \
    X(feels_nothing, 1) \
    X(max_steps, 1) \
    X(window_samples, 1) \
    X(wrench_clip, 6)

/* `ENTRIES`: name and size */
#define ENTRIES(X) \
    X(hole_offset_xy, 2) \
    X(height, 1) \
    X(contact_height_known, 1) \
    X(yaw, 1) \
    X(tilt, 2) \
    X(force_mean, 3) \
    X(torque_mean, 3) \
    X(force_z_range, 3) \
    X(contact_centroid, 2) \
    X(lag, 4) \
    X(previous_action, 4) \
    X(lock_height, 1) \
    X(phase, 1) \
    X(time_fraction, 1) \
    X(eef_position, 3) \
    X(last_joint_angle, 1) \
    X(hole_position, 3) \
    X(wrench_normalised, 6)

typedef struct {
    MEMORY(MEMBER)
} Memory;

typedef struct {
    MEASUREMENT(MEMBER)
} Measurement;

typedef struct {
    OBSERVATION_CONSTANTS(CONSTANT_MEMBER)
} ObservationConstants;

ptrdiff_t entry_size(int64_t entry);
int64_t entry_count(void);

/* Write one frame of the entries, with cosine and sine of minus the yaw, and update the memory but its steps. */
void observation_frame(
    const ObservationConstants *constants, const int64_t *entries, ptrdiff_t count, Memory *memory,
    const Measurement *measurement, const Summary *felt, double cosine, double sine, float *frame);

#endif
