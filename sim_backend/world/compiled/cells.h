/* world.py: what a tick leaves in MuJoCo's data. */
#ifndef CELLS_H
#define CELLS_H

#include "rows.h"

/* Attributes of `World`; the first four are views into MuJoCo's data, the last two are of `Gears`. */
#define CELLS_FIELDS(X) \
    X(qpos, NUMBER, AT_LEAST(6), READ) \
    X(tcp_position, NUMBER, 3, READ) \
    X(tcp_rotation, NUMBER, 9, READ) \
    X(load, NUMBER, 6, READ) \
    X(joints, NUMBER, 6, WRITTEN) \
    X(position, NUMBER, 3, WRITTEN) \
    X(rotation, NUMBER, 9, WRITTEN) \
    X(carried, NUMBER, 6, WRITTEN) \
    X(ticks, INTEGER, 1, WRITTEN) \
    X(offset, NUMBER, 3, READ) \
    X(jitter, NUMBER, AT_LEAST(3), READ) \
    X(estimate, NUMBER, 3, WRITTEN) \
    X(play, NUMBER, 6, WRITTEN) \
    X(gears, NUMBER, 2, READ)

#define CELLS_NUMBERS(X) \
    X(estimate_ticks) \
    X(ripple_waves)

typedef struct {
    CELLS_FIELDS(AS_ROWS)
} Cells;

typedef struct {
    CELLS_NUMBERS(AS_NUMBER)
} CellsConstants;

/* The numbers of a cell's physics that its tick is measured from. */
typedef struct {
    const double *qpos, *tcp_position, *tcp_rotation, *load;
} Physics;

/* Those that the batch has copied out of MuJoCo's data. */
Physics cells_physics(const Cells *cells, intptr_t cell);

/* Count the tick, and take the measured values, the sensor's load and the camera's estimate. */
void cells_measure(const Cells *cells, const CellsConstants *constants, const Physics *physics, intptr_t cell);

/* gears.py: turn set-points of the drives into those of the links, in place. */
void cells_transmit(const Cells *cells, const CellsConstants *constants, intptr_t cell, double set_points[6]);

#endif
