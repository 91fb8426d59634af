#include "window.h"

#include <string.h>

#include "numbers.h"

/* Samples are summed first to last. They lie side by side by cell, so the cells are the inner loop. */

static Window newest_of(const Window *window, ptrdiff_t newest)
{
    const ptrdiff_t samples = newest < window->samples ? newest : window->samples;
    return (Window){window->first + (window->samples - samples) * 6 * window->cells, samples, window->cells};
}

void window_means(const Window *window, ptrdiff_t newest, double *means)
{
    const Window used = newest_of(window, newest);
    const ptrdiff_t width = 6 * used.cells;
    memset(means, 0, (size_t)width * sizeof *means);
    for (ptrdiff_t t = 0; t < used.samples; t++)
        for (ptrdiff_t k = 0; k < width; k++)
            means[k] += used.first[t * width + k];
    for (ptrdiff_t k = 0; k < width; k++)
        means[k] /= (double)used.samples;
}

void window_summaries(const Window *window, ptrdiff_t newest, double *means, Summary *summaries)
{
    const Window used = newest_of(window, newest);
    for (ptrdiff_t cell = 0; cell < used.cells; cell++)
        summaries[cell] = (Summary){means + 6 * cell, INFINITY, -INFINITY, 0.0};
    window_means(window, newest, means);
    for (ptrdiff_t t = 0; t < used.samples; t++)
        for (ptrdiff_t cell = 0; cell < used.cells; cell++) {
            Summary *summary = &summaries[cell];
            const double fz = used.first[6 * (t * used.cells + cell) + 2], deviation = fz - summary->mean[2];
            summary->fz_min = minimum(summary->fz_min, fz);
            summary->fz_max = maximum(summary->fz_max, fz);
            summary->fz_std += deviation * deviation;
        }
    for (ptrdiff_t cell = 0; cell < used.cells; cell++)
        summaries[cell].fz_std = sqrt(summaries[cell].fz_std / (double)used.samples);
}
