#include "advance.h"

#include <string.h>

#include <mujoco/mujoco.h>

#include "functions.h"

static const char OURS[] = "dsl-assembly-"; /* `scene.specify` */

static void sense(const Advance *advance, const Physics *physics, intptr_t tick, intptr_t cell)
{
    const SensorConstants *constants = advance->sensor_constants;
    intptr_t slot = around(advance->slot + 1 + tick, sensor_slots(&advance->sensor));
    cells_measure(&advance->cells, advance->cells_constants, physics, cell);
    sensor_sense(&advance->sensor, constants, numbers(advance->cells.carried, cell), slot, cell);
    sensor_compensate(
        &advance->sensor, constants, numbers(advance->sensor.sensed, cell), numbers(advance->cells.rotation, cell), cell);
    memcpy(numbers(advance->readings, tick) + 6 * cell, numbers(advance->sensor.wrench, cell), 6 * sizeof(double));
}

static void drive(const Advance *advance, intptr_t cell, double set_points[6])
{
    const Together *together = &advance->together;
    const Measured measured = {
        .joints = advance->cells.joints,
        .wrench = advance->sensor.wrench,
        .position = advance->cells.position,
        .orientation = {together->before.data + 12 * sizeof(double), together->before.stride},
        .saturated = advance->sensor.saturated,
    };
    double inverse[36];
    if (arm_lead(&advance->arm, advance->arm_constants, &measured, cell, cell))
        inverse6(numbers(advance->arm.jacobians, cell), inverse);
    arm_follow(&advance->arm, advance->arm_constants, cell, cell, inverse, set_points);
    cells_transmit(&advance->cells, advance->cells_constants, cell, set_points);
}

/* Sense the end of the step before, and drive the arm into this one. */
static void tick(const Advance *advance, intptr_t cell, const mjData *data, double set_points[6])
{
    const double *before = numbers(advance->together.before, cell);
    const int64_t done = (*integer(advance->together.done, cell))++;
    if (done >= advance->ticks) /* a step more than was asked for */
        return;
    if (done > 0) {
        const Physics physics = {data->qpos, before, before + 3, data->sensordata};
        sense(advance, &physics, done - 1, cell);
    }
    drive(advance, cell, set_points);
}

/* MuJoCo calls this in each step, on its threads, when it has computed the kinematics of the step's beginning. What a
   tick measures is of the step before: that step's end, and the kinematics of its beginning.

   MuJoCo resets data whose numbers are bad, controls included. It does so before it calls this, or afterwards: it then
   begins the same step anew. */
static void control(const mjModel *model, mjData *data)
{
    const Advance *advance;
    if (model->nnumericdata != 2 || strncmp(model->names, OURS, sizeof OURS - 1) != 0)
        return;
    memcpy(&advance, model->numeric_data, sizeof advance);
    if (advance == NULL || !advance->open)
        return;
    const TogetherConstants *constants = advance->constants;
    if (!(constants->tcp_site >= 0.0 && constants->tcp_site < (double)model->nsite && constants->gripper_body >= 0.0 &&
          constants->gripper_body < (double)model->nbody))
        return; /* not this scene: the call will not be whole */
    const intptr_t cell = (intptr_t)model->numeric_data[1], site = (intptr_t)constants->tcp_site;
    const intptr_t body = (intptr_t)constants->gripper_body;
    double *before = numbers(advance->together.before, cell), none[6];
    const int first = *integer(advance->together.done, cell) == 0;
    const int reset = first ? memcmp(data->qpos, numbers(advance->cells.qpos, cell), sizeof none) != 0
                            : data->time <= before[16];
    if (first || !reset || data->warning[mjWARN_BADQACC].number == 0)
        tick(advance, cell, data, reset ? none : data->ctrl);
    memcpy(before, data->site_xpos + 3 * site, 3 * sizeof(double));
    memcpy(before + 3, data->site_xmat + 9 * site, 9 * sizeof(double));
    memcpy(before + 12, data->xquat + 4 * body, 4 * sizeof(double));
    before[16] = data->time;
}

static mjtNum no_time(void) { return 0.0; }

int advance_version(void) { return mjVERSION_HEADER; }

void *advance_callback(void) { return (void *)control; }

void *advance_clock(void) { return (void *)no_time; }

void advance_open(Advance *advance)
{
    const Together *together = &advance->together;
    advance->open = 1;
    for (intptr_t cell = 0; cell < advance->n; cell++) {
        memcpy(numbers(together->before, cell) + 12, numbers(together->orientation, cell), 4 * sizeof(double));
        memcpy(numbers(together->told, cell), &advance, sizeof advance);
        numbers(together->told, cell)[1] = (double)cell;
        *integer(together->done, cell) = 0;
    }
}

int advance_close(Advance *advance, int whole)
{
    const Together *together = &advance->together;
    advance->open = 0;
    for (intptr_t cell = 0; cell < advance->n; cell++) {
        memset(numbers(together->told, cell), 0, 2 * sizeof(double));
        whole &= *integer(together->done, cell) == advance->ticks;
    }
    for (intptr_t cell = 0; whole && cell < advance->n; cell++) {
        const Physics physics = cells_physics(&advance->cells, cell);
        sense(advance, &physics, advance->ticks - 1, cell);
    }
    return whole;
}
