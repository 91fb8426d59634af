#include "lock.h"

#include <string.h>

Felt lock_feel(const LockConstants *constants, const LockState *state, const double p[3], const double w[6])
{
    Felt felt;
    const double moved = state->fresh[0] ? 0.0 : 1.0;
    felt.edge = 0;
    for (int k = 0; k < 6; k++) {
        double ratio = w[k] / constants->clip[k];
        felt.n[k] = clip(ratio, -1.0, 1.0);
        felt.delta_n[k] = (felt.n[k] - state->previous_n[k]) * moved;
        felt.edge |= fabs(felt.delta_n[k]) > constants->delta_f[k];
        felt.saturated[k] = fabs(ratio) >= 1.0;
    }
    for (int k = 0; k < 3; k++)
        felt.delta_p[k] = (p[k] - state->previous_position[k]) * moved;
    felt.contact = felt.n[2] >= constants->contact_threshold[0];
    return felt;
}

/* `_Search` */
typedef struct {
    int under_way, too_deep, too_long;
    double z_contact0, start_z, command;
    int32_t steps;
} Search;

/* Algorithm 1, "while not contact": creep down by δz plus the policy's dz, within bounds */
static Search search_of(const LockConstants *constants, const LockState *state, const Felt *felt, double z, double dz)
{
    Search search;
    search.under_way = state->phase[0] == SEEK && constants->mode[0] != OFF && !felt->contact;
    search.start_z = !search.under_way ? NAN : isnan(state->seek_start_z[0]) ? z : state->seek_start_z[0];
    search.steps = search.under_way ? (int32_t)((uint32_t)state->seek_steps[0] + 1) : 0;
    const double deepest = search.start_z - constants->search_depth_m[0];
    search.too_deep = search.under_way && z - constants->seek_step_m[0] < deepest;
    search.too_long = search.under_way && search.steps > constants->search_steps[0];
    const double asked = z - constants->seek_step_m[0] + dz;
    const double command = search.too_deep || search.too_long ? maximum(asked, z) : asked;
    search.command = fmax(command, deepest);
    search.z_contact0 = felt->contact && isnan(state->z_contact0[0]) ? z : state->z_contact0[0];
    return search;
}

/* `_Height` */
typedef struct {
    double asked, command, lock, next_lock;
    int32_t phase, next_phase;
    int edge;
} Height;

/* `_paper`: Algorithm 1 */
static Height paper(
    const LockConstants *constants, double z_floor, const Felt *felt, const Search *search, double increment, double z,
    double dz)
{
    Height height;
    const int locked = !search->under_way;
    const double raised = maximum(increment, 0.0), drift = constants->beta2[0] * length3(felt->delta_p);
    const double highest = search->z_contact0 + constants->lift_max_m[0];
    const double lock = maximum(minimum(z + (felt->edge ? raised : drift), highest), z_floor);
    height.asked = locked ? z + dz : search->command;
    const double command = locked ? maximum(height.asked, lock - constants->press_m[0]) : height.asked;
    const int lost = locked && felt->n[2] < constants->release_threshold[0];
    height.command = maximum(command, z_floor);
    height.lock = locked ? lock : NAN;
    height.next_lock = lost ? NAN : height.lock;
    height.phase = locked ? LOCKED : SEEK;
    height.next_phase = lost ? SEEK : height.phase;
    height.edge = felt->edge && locked;
    return height;
}

/* `_sliding` and `_off` */
static Height unlocked(const LockConstants *constants, double z_floor, const Search *search, double z, double dz)
{
    Height height = {.lock = NAN, .next_lock = NAN, .phase = search->under_way ? SEEK : FREE};
    height.next_phase = height.phase;
    height.asked = search->under_way ? search->command : z + dz;
    height.command = constants->mode[0] == OFF ? height.asked : maximum(height.asked, z_floor);
    return height;
}

void lock_step(
    const LockConstants *constants, LockState *state, double z_floor, const Felt *felt, double increment,
    const double p[3], const double action[4], LockOutput *out)
{
    const double z = p[2], dz = action[2];
    const Search search = search_of(constants, state, felt, z, dz);
    const Height height = constants->mode[0] == PAPER ? paper(constants, z_floor, felt, &search, increment, z, dz)
                                                      : unlocked(constants, z_floor, &search, z, dz);
    /* Algorithm 1 holds x and y until the first contact */
    const int moves_xy = !search.under_way || isfinite(search.z_contact0);
    out->position[0] = p[0] + (moves_xy ? action[0] : 0.0);
    out->position[1] = p[1] + (moves_xy ? action[1] : 0.0);
    out->position[2] = height.command;
    out->dyaw[0] = action[3];
    out->z_lock[0] = height.lock;
    out->phase[0] = height.phase;
    out->edge[0] = (unsigned char)height.edge;
    out->contact[0] = (unsigned char)felt->contact;
    out->clamped[0] = height.command > height.asked;
    memcpy(out->saturated, felt->saturated, sizeof out->saturated);
    out->search_depth_exceeded[0] = (unsigned char)search.too_deep;
    out->search_time_exceeded[0] = (unsigned char)search.too_long;

    state->phase[0] = height.next_phase;
    state->z_lock[0] = height.next_lock;
    state->z_contact0[0] = search.z_contact0;
    memcpy(state->previous_n, felt->n, sizeof state->previous_n);
    memcpy(state->previous_position, p, sizeof state->previous_position);
    state->fresh[0] = 0;
    state->seek_start_z[0] = search.start_z;
    state->seek_steps[0] = search.steps;
}
