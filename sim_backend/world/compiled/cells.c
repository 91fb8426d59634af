#include "cells.h"

#include <string.h>

#include "functions.h"

void cells_measure(const Cells *cells, const CellsConstants *constants, const Physics *physics, intptr_t cell)
{
    memcpy(numbers(cells->joints, cell), physics->qpos, 6 * sizeof(double));
    memcpy(numbers(cells->position, cell), physics->tcp_position, 3 * sizeof(double));
    memcpy(numbers(cells->rotation, cell), physics->tcp_rotation, 9 * sizeof(double));
    for (int k = 0; k < 6; k++)
        numbers(cells->carried, cell)[k] = -physics->load[k];
    const int64_t tick = *integer(cells->ticks, cell) += 1, every = (int64_t)constants->estimate_ticks;
    const int64_t frame = (tick - around(tick, every)) / every;
    const double *jitter = numbers(cells->jitter, cell) + 3 * around(frame, cells->jitter.size / 3);
    for (int k = 0; k < 3; k++)
        numbers(cells->estimate, cell)[k] = numbers(cells->offset, cell)[k] + jitter[k];
}

Physics cells_physics(const Cells *cells, intptr_t cell)
{
    return (Physics){
        numbers(cells->qpos, cell),
        numbers(cells->tcp_position, cell),
        numbers(cells->tcp_rotation, cell),
        numbers(cells->load, cell),
    };
}

void cells_transmit(const Cells *cells, const CellsConstants *constants, intptr_t cell, double set_points[6])
{
    const double *gears = numbers(cells->gears, cell), half = gears[0], ripple = gears[1];
    double *play = numbers(cells->play, cell), phase[6], wave[6];
    if (half == 0.0 && ripple == 0.0)
        return;
    for (int k = 0; k < 6; k++) {
        const double low = set_points[k] - half, high = set_points[k] + half;
        play[k] = play[k] < low ? low : play[k];
        play[k] = play[k] > high ? high : play[k];
        phase[k] = constants->ripple_waves * play[k];
    }
    sines(phase, wave, 6);
    for (int k = 0; k < 6; k++)
        set_points[k] = play[k] + ripple * wave[k];
}
