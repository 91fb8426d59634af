#include "observation.h"

#include <string.h>

static const double CENTROID_FLOOR_N = 1.0, CENTROID_LIMIT_M = 0.03;

#define AS_ENTRY(name, size) ENTRY_##name,
#define AS_SIZE(name, size) size,
enum { ENTRIES(AS_ENTRY) };
static const ptrdiff_t SIZES[] = {ENTRIES(AS_SIZE)};

ptrdiff_t entry_size(int64_t entry) { return SIZES[entry]; }
int64_t entry_count(void) { return sizeof SIZES / sizeof *SIZES; }

/* `Reading` */
typedef struct {
    const Measurement *m;
    const Summary *felt;
    double hole[3], hole_frame[3], time_fraction, cosine, sine;
    int contact_known;
} Reading;

/* `ObservationBuilder._hole` */
static void remember_hole(Memory *memory, const double estimate[3])
{
    const int seen = isfinite(estimate[0]) && isfinite(estimate[1]) && isfinite(estimate[2]);
    const int32_t count = memory->hole_count[0] = (int32_t)((uint32_t)memory->hole_count[0] + (uint32_t)seen);
    for (int k = 0; k < 3; k++) {
        const double change = (estimate[k] - memory->hole_mean[k]) / (count > 1 ? count : 1);
        memory->hole_mean[k] += seen ? change : 0.0;
    }
}

static void turn_xy(const Reading *r, double x, double y, double out[2])
{
    out[0] = r->cosine * x - r->sine * y;
    out[1] = r->sine * x + r->cosine * y;
}

static void turn(const Reading *r, const double vector[3], double out[3])
{
    turn_xy(r, vector[0], vector[1], out);
    out[2] = vector[2];
}

static void contact_centroid(const Reading *r, double out[2])
{
    /* A normal force N, upwards at (x, y) from the TCP, gives Tx = y N, Ty = -x N */
    const double *mean = r->felt->mean, normal = maximum(mean[2], CENTROID_FLOOR_N);
    turn_xy(r, -mean[4] / normal, mean[3] / normal, out);
    for (int k = 0; k < 2; k++)
        out[k] = clip(out[k], -CENTROID_LIMIT_M, CENTROID_LIMIT_M);
}

static void lag(const Reading *r, double out[4])
{
    const Measurement *m = r->m;
    double apart[3];
    for (int k = 0; k < 3; k++)
        apart[k] = m->target_position[k] - m->position[k];
    turn(r, apart, out);
    out[3] = wrap(m->target_yaw[0] - m->yaw[0]);
}

/* `np.nan_to_num` with zero for what is not a number and the largest numbers for infinities */
static double known(double number)
{
    return isnan(number) ? 0.0 : clip(number, -1.7976931348623157e308, 1.7976931348623157e308);
}

static void read_entry(const ObservationConstants *constants, const Reading *r, int64_t entry, double *out)
{
    const Measurement *m = r->m;
    switch (entry) {
    case ENTRY_hole_offset_xy:
        turn_xy(r, r->hole[0] - m->position[0], r->hole[1] - m->position[1], out);
        break;
    case ENTRY_height:
        out[0] = m->position[2] - (r->contact_known ? m->contact_z[0] : r->hole[2]);
        break;
    case ENTRY_contact_height_known:
        out[0] = r->contact_known;
        break;
    case ENTRY_yaw:
        out[0] = wrap(m->yaw[0] - m->start_yaw[0]);
        break;
    case ENTRY_tilt:
        turn_xy(r, m->tilt[0], m->tilt[1], out);
        break;
    case ENTRY_force_mean:
        turn(r, r->felt->mean, out);
        break;
    case ENTRY_torque_mean:
        turn(r, r->felt->mean + 3, out);
        break;
    case ENTRY_force_z_range:
        out[0] = r->felt->fz_min;
        out[1] = r->felt->fz_max;
        out[2] = r->felt->fz_std;
        break;
    case ENTRY_contact_centroid:
        contact_centroid(r, out);
        break;
    case ENTRY_lag:
        lag(r, out);
        break;
    case ENTRY_previous_action:
        memcpy(out, m->previous_action, sizeof m->previous_action);
        break;
    case ENTRY_lock_height:
        out[0] = known(m->z_lock[0] - m->position[2]);
        break;
    case ENTRY_phase:
        out[0] = m->phase[0];
        break;
    case ENTRY_time_fraction:
        out[0] = r->time_fraction;
        break;
    case ENTRY_eef_position:
        memcpy(out, m->position, sizeof m->position);
        break;
    case ENTRY_last_joint_angle:
        out[0] = m->last_joint[0];
        break;
    case ENTRY_hole_position:
        memcpy(out, r->hole_frame, sizeof r->hole_frame);
        break;
    default: /* wrench_normalised */
        for (int k = 0; k < 6; k++)
            out[k] = clip(r->felt->mean[k] / constants->wrench_clip[k], -1.0, 1.0);
    }
}

void observation_frame(
    const ObservationConstants *constants, const int64_t *entries, ptrdiff_t count, Memory *memory,
    const Measurement *measurement, const Summary *felt, double cosine, double sine, float *frame)
{
    const double *nominal = constants->uses_nominal[0] ? measurement->nominal_hole : NULL;
    remember_hole(memory, measurement->hole_estimate);
    Reading reading = {
        .m = measurement,
        .felt = felt,
        .cosine = cosine,
        .sine = sine,
        .time_fraction = memory->steps[0] / constants->max_steps[0],
        .contact_known = isfinite(measurement->contact_z[0]) && !constants->feels_nothing[0],
    };
    for (int k = 0; k < 3; k++) {
        reading.hole[k] = nominal != NULL ? nominal[k] : memory->hole_count[0] > 0 ? memory->hole_mean[k] : NAN;
        reading.hole_frame[k] = nominal != NULL ? nominal[k] : measurement->hole_estimate[k];
    }
    for (ptrdiff_t e = 0; e < count; e++) {
        double values[6];
        read_entry(constants, &reading, entries[e], values);
        for (ptrdiff_t k = 0; k < SIZES[entries[e]]; k++)
            *frame++ = (float)values[k];
    }
}
