#include "cells.h"

#include <string.h>

void cells_measure(const Cells *cells, const CellsConstants *constants, intptr_t n)
{
    const int64_t per_frame = (int64_t)constants->estimate_ticks, frames = (int64_t)constants->camera_frames;
    for (intptr_t cell = 0; cell < n; cell++) {
        memcpy(numbers(cells->joints, cell), numbers(cells->qpos, cell), 6 * sizeof(double));
        memcpy(numbers(cells->position, cell), numbers(cells->tcp_position, cell), 3 * sizeof(double));
        memcpy(numbers(cells->rotation, cell), numbers(cells->tcp_rotation, cell), 9 * sizeof(double));
        for (int k = 0; k < 6; k++)
            numbers(cells->carried, cell)[k] = -numbers(cells->load, cell)[k];
        int64_t tick = *integer(cells->ticks, cell) += 1;
        const double *jitter = numbers(cells->jitter, cell) + 3 * (tick / per_frame % frames);
        for (int k = 0; k < 3; k++)
            numbers(cells->estimate, cell)[k] = numbers(cells->offset, cell)[k] + jitter[k];
    }
}
