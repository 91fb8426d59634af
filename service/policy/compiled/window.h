/* window.py: summaries of the windows of n cells. */
#ifndef WINDOW_H
#define WINDOW_H

#include <stddef.h>

/* Samples (T, n, 6), oldest first. */
typedef struct {
    const double *first;
    ptrdiff_t samples, cells;
} Window;

/* `WrenchSummary` of one cell */
typedef struct {
    const double *mean;
    double fz_min, fz_max, fz_std;
} Summary;

/* Mean (n, 6) of the `newest` samples, or of all where the window is shorter. */
void window_means(const Window *window, ptrdiff_t newest, double *means);

/* `summarise`, for each cell. The summaries refer to `means`. */
void window_summaries(const Window *window, ptrdiff_t newest, double *means, Summary *summaries);

#endif
