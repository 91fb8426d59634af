/* sensor.py: one reading of a force/torque sensor, in the two steps of `ForceTorqueSensor.read`. */
#ifndef SENSOR_H
#define SENSOR_H

#include "rows.h"

/* Attributes of `ForceTorqueSensor`. */
#define SENSOR_FIELDS(X) \
    X(tick, INTEGER, 1, WRITTEN) \
    X(delay, INTEGER, 1, READ) \
    X(history, NUMBER, AT_LEAST(6), WRITTEN) \
    X(noise, SINGLE, AT_LEAST(6), READ) \
    X(gain, NUMBER, 1, READ) \
    X(bias, NUMBER, 6, READ) \
    X(drift, NUMBER, 6, READ) \
    X(zero, NUMBER, 6, READ) \
    X(average, NUMBER, 6, WRITTEN) \
    X(sensed, NUMBER, 6, WRITTEN) \
    X(raw, NUMBER, 6, WRITTEN) \
    X(wrench, NUMBER, 6, WRITTEN) \
    X(saturated, TRUTH, 1, WRITTEN)

#define SENSOR_NUMBERS(X) \
    X(drift_ticks) \
    X(zero_ticks) \
    X(weight)

#define SENSOR_VECTORS(X) \
    X(range, 6) \
    X(com, 3) \
    X(tcp, 3)

typedef struct {
    SENSOR_FIELDS(AS_ROWS)
} Sensor;

typedef struct {
    SENSOR_NUMBERS(AS_NUMBER)
    SENSOR_VECTORS(AS_VECTOR)
} SensorConstants;

/* Number of slots of the history. */
intptr_t sensor_slots(const Sensor *sensor);

/* `sense`: from the true load on the flange to `sensed`; `slot` is that of this reading. */
void sensor_sense(
    const Sensor *sensor, const SensorConstants *constants, const double load[6], intptr_t slot, intptr_t cell);

/* The latest readings as `wrench` without any zero, into rows (n, 6). */
void sensor_unzeroed(const Sensor *sensor, const SensorConstants *constants, Rows rotation, Rows out, intptr_t n);

/* From what was sensed and the flange's orientation to `raw`, `wrench` and `saturated`. */
void sensor_compensate(
    const Sensor *sensor, const SensorConstants *constants, const double reading[6], const double turned[9], intptr_t cell);

#endif
