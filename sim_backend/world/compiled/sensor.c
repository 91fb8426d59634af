#include "sensor.h"

#include <math.h>
#include <string.h>

#include "linear.h"

intptr_t sensor_slots(const Sensor *sensor) { return sensor->history.size / 6; }

void sensor_sense(
    const Sensor *sensor, const SensorConstants *constants, const double load[6], intptr_t slot, intptr_t cell)
{
    const intptr_t slots = sensor_slots(sensor), noise_rows = sensor->noise.size / 6;
    double *history = numbers(sensor->history, cell), *out = numbers(sensor->sensed, cell);
    int64_t *tick = integer(sensor->tick, cell);
    for (intptr_t k = 0; k < slots; k++)
        if (k == slot || *tick == 0)
            memcpy(history + 6 * k, load, 6 * sizeof *load);
    const double *felt = history + 6 * around(slot - around(*integer(sensor->delay, cell), slots) + 1, slots);
    const float *noise = singles(sensor->noise, cell) + 6 * around(*tick, noise_rows);
    const double *bias = numbers(sensor->bias, cell), *drift = numbers(sensor->drift, cell);
    const double gain = *numbers(sensor->gain, cell);
    const double warmed = fmin((double)*tick, constants->drift_ticks);
    for (int k = 0; k < 6; k++)
        out[k] = felt[k] * gain + noise[k] + bias[k] + drift[k] * warmed;
    *tick += 1;
}

/* `ForceTorqueSensor._gravity` */
static void gravity_of(const SensorConstants *constants, const double rotation[9], double gravity[6])
{
    for (int k = 0; k < 3; k++)
        gravity[k] = rotation[6 + k] * -constants->weight;
    moment(constants->com, gravity, gravity + 3);
}

/* `ForceTorqueSensor._at_tcp` */
static void at_tcp(const SensorConstants *constants, const double rotation[9], double own[6], double wrench[6])
{
    double about_tcp[3];
    moment(constants->tcp, own, about_tcp);
    for (int k = 0; k < 3; k++)
        own[3 + k] -= about_tcp[k];
    product(rotation, own, wrench, 3);
    product(rotation, own + 3, wrench + 3, 3);
}

void sensor_unzeroed(const Sensor *sensor, const SensorConstants *constants, Rows rotation, Rows out, intptr_t n)
{
    for (intptr_t cell = 0; cell < n; cell++) {
        const double *raw = numbers(sensor->raw, cell), *turned = numbers(rotation, cell);
        double gravity[6], own[6];
        gravity_of(constants, turned, gravity);
        for (int k = 0; k < 6; k++)
            own[k] = raw[k] - gravity[k];
        at_tcp(constants, turned, own, numbers(out, cell));
    }
}

void sensor_compensate(
    const Sensor *sensor, const SensorConstants *constants, const double reading[6], const double turned[9], intptr_t cell)
{
    const double *zero = numbers(sensor->zero, cell);
    double *raw = numbers(sensor->raw, cell), *average = numbers(sensor->average, cell);
    double gravity[6], own[6];
    int saturated = 0;
    for (int k = 0; k < 6; k++) {
        saturated |= fabs(reading[k]) >= constants->range[k];
        raw[k] = within(reading[k], constants->range[k]);
    }
    *truth(sensor->saturated, cell) = (unsigned char)saturated;
    gravity_of(constants, turned, gravity);
    for (int k = 0; k < 6; k++) {
        own[k] = raw[k] - gravity[k];
        average[k] += (own[k] - average[k]) / constants->zero_ticks;
        own[k] -= zero[k];
    }
    at_tcp(constants, turned, own, numbers(sensor->wrench, cell));
}
