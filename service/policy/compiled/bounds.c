#include "bounds.h"

#include <string.h>

/* Finite, and small enough to be squared; not so for what is not a number */
static int is_usable(const Pose *pose)
{
    return fabs(pose->position[0]) <= 1e6 && fabs(pose->position[1]) <= 1e6 && fabs(pose->position[2]) <= 1e6 &&
           fabs(pose->yaw) <= 1e6;
}

static double distance(const double a[3], const double b[3])
{
    const double apart[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
    return length3(apart);
}

/* `_within`: pull `point` straight towards `centre`; return whether it was outside. */
static int within(const double centre[3], double point[3], double radius)
{
    const double away = distance(point, centre);
    if (!(away > radius))
        return 0;
    const double factor = radius / maximum(away, radius);
    for (int k = 0; k < 3; k++)
        point[k] = centre[k] + (point[k] - centre[k]) * factor;
    return 1;
}

void bounds_apply(
    const BoundsConstants *constants, Pose measured, Pose asked, const Pose *previous, double tilt, Bounded *out)
{
    const int usable = is_usable(&measured) && is_usable(&asked);
    if (!usable)
        measured = asked = *previous;

    /* Yaw is an offset from the middle of its range here, so that the range has no seam at ±π */
    const double turn_measured = wrap(measured.yaw - constants->yaw_centre_rad[0]);
    const double turn_asked = turn_measured + wrap(asked.yaw - measured.yaw);
    const double turn_previous = turn_measured + wrap(previous->yaw - measured.yaw);

    const double speed_m = constants->speed_mps[0] * constants->period_s[0];
    const double speed_rad = constants->speed_radps[0] * constants->period_s[0];
    const double step_m = fmin(constants->step_m[0], speed_m), step_rad = fmin(constants->step_rad[0], speed_rad);
    const double asked_m = distance(asked.position, previous->position);
    const double asked_rad = fabs(turn_asked - turn_previous);

    double position[3], turn, leash_rad = constants->leash_rad[0];
    memcpy(position, asked.position, sizeof position);
    const int leashed = within(measured.position, position, constants->leash_m[0]);
    turn = clip(turn_asked, turn_measured - leash_rad, turn_measured + leash_rad);
    out->leash[0] = leashed || turn != turn_asked;
    const double to_go_m = distance(position, previous->position), to_go_rad = fabs(turn - turn_previous);
    out->step[0] = to_go_m > constants->step_m[0] || to_go_rad > constants->step_rad[0];
    out->speed[0] = to_go_m > speed_m || to_go_rad > speed_rad;
    within(previous->position, position, step_m);
    turn = clip(turn, turn_previous - step_rad, turn_previous + step_rad);

    int boxed = 0;
    for (int k = 0; k < 3; k++) {
        out->position[k] = clip(position[k], constants->workspace_lower[k], constants->workspace_upper[k]);
        boxed |= out->position[k] != position[k];
    }
    const double half_range = constants->yaw_half_range_rad[0];
    const double turn_in_range = half_range >= PI ? turn : clip(turn, -half_range, half_range);
    out->yaw[0] = constants->yaw_centre_rad[0] + wrap(turn_in_range);
    out->invalid[0] = !usable;
    out->workspace[0] = (unsigned char)boxed;
    out->yaw_range[0] = turn_in_range != turn;
    out->tilt[0] = !(fabs(tilt) <= constants->tilt_rad[0]);
    out->excess[0] = maximum(asked_m / step_m, asked_rad / step_rad);
}
