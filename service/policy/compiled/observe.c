#include <string.h>

#include "calls.h"

#define IN_MEMORY(name, kind, size) {#name, kind, size, offsetof(Memory, name)},
#define IN_MEASUREMENT(name, kind, size) {#name, kind, size, offsetof(Measurement, name)},

static const Field MEMORY_FIELDS[] = {MEMORY(IN_MEMORY)};
static const Field MEASUREMENT_FIELDS[] = {MEASUREMENT(IN_MEASUREMENT)};

typedef struct {
    const int64_t *entries, *columns;
    const float *frames;
    npy_intp count, size, depth, width;
} Layout;

/* Take entries, columns and frames (..., depth, width) that agree with each other. */
static int take_layout(Call *call, PyObject *entries, PyObject *columns, PyObject *frames, Layout *layout)
{
    PyArrayObject *entry = (PyArrayObject *)hold(call, PyArray_FROM_OTF(entries, NPY_INT64, NPY_ARRAY_CARRAY_RO));
    PyArrayObject *column = (PyArrayObject *)hold(call, PyArray_FROM_OTF(columns, NPY_INT64, NPY_ARRAY_CARRAY_RO));
    if (entry == NULL || column == NULL)
        return -1;
    *layout = (Layout){
        .entries = PyArray_DATA(entry),
        .columns = PyArray_DATA(column),
        .count = PyArray_SIZE(entry),
        .size = PyArray_SIZE(column),
    };
    for (npy_intp k = 0; k < layout->count; k++) {
        if (layout->entries[k] < 0 || layout->entries[k] >= entry_count()) {
            PyErr_SetString(PyExc_TypeError, "there is no such entry");
            return -1;
        }
        layout->width += entry_size(layout->entries[k]);
    }
    if ((layout->frames = take_frames(call, frames, layout->width, &layout->depth)) == NULL)
        return -1;
    for (npy_intp k = 0; k < layout->size; k++)
        if (layout->columns[k] < 0 || layout->columns[k] >= layout->depth * layout->width) {
            PyErr_SetString(PyExc_TypeError, "there is no such column");
            return -1;
        }
    return 0;
}

/* Shift the frames of one cell, or fill them all with the newest one where it is the first. */
static void remember_frame(const Layout *layout, float *frames, const float *newest, int first)
{
    const size_t bytes = (size_t)layout->width * sizeof *frames;
    if (!first)
        memmove(frames, frames + layout->width, (size_t)(layout->depth - 1) * bytes);
    for (npy_intp row = first ? 0 : layout->depth - 1; row < layout->depth; row++)
        memcpy(frames + row * layout->width, newest, bytes);
}

PyObject *observe(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    (void)self;
    Call call = {.count = 0};
    Layout layout;
    Window window;
    const char *measured[MOST_FIELDS], *before[MOST_FIELDS];
    char *after[MOST_FIELDS];
    const Constants *constants;
    if (!has(count, 7) || (constants = take_constants(given[0])) == NULL ||
        take_batch(&call, first_of(given[3]), "position", 3) < 0)
        return NULL;
    if (take_layout(&call, given[1], given[2], given[6], &layout) < 0 ||
        take_fields(&call, given[3], MEASUREMENT_FIELDS, COUNT(MEASUREMENT_FIELDS), measured) < 0 ||
        take_window(&call, given[4], &window) < 0 ||
        take_fields(&call, given[5], MEMORY_FIELDS, COUNT(MEMORY_FIELDS), before) < 0)
        return end(&call, NULL);
    const npy_intp rows[] = {layout.depth, layout.width}, cell_size = layout.depth * layout.width;
    const double *cosine = turns(&call, (const double *)measured[1], -1.0);
    double *means = scratch(&call, call.n, 6 * sizeof *means);
    Summary *felt = scratch(&call, call.n, sizeof *felt);
    float *newest = scratch(&call, layout.width, sizeof *newest);
    PyObject *frames = hold(&call, make(&call, SINGLE, 2, rows));
    PyObject *observation = hold(&call, make(&call, SINGLE, 1, &layout.size));
    PyObject *memory = hold(&call, make_fields(&call, MEMORY_FIELDS, COUNT(MEMORY_FIELDS), after));
    if (cosine == NULL || means == NULL || felt == NULL || newest == NULL || frames == NULL || observation == NULL ||
        memory == NULL)
        return end(&call, NULL);
    window_summaries(&window, (ptrdiff_t)constants->observation.window_samples[0], means, felt);
    float *observed = PyArray_DATA((PyArrayObject *)observation), *kept = PyArray_DATA((PyArrayObject *)frames);
    for (npy_intp cell = 0; cell < call.n; cell++) {
        float *shifted = kept + cell * cell_size;
        Measurement measurement;
        Memory now;
        gather(&measurement, MEASUREMENT_FIELDS, COUNT(MEASUREMENT_FIELDS), measured, cell);
        gather(&now, MEMORY_FIELDS, COUNT(MEMORY_FIELDS), before, cell);
        const int32_t steps = now.steps[0];
        observation_frame(
            &constants->observation, layout.entries, layout.count, &now, &measurement, &felt[cell], cosine[cell],
            cosine[call.n + cell], newest);
        memcpy(shifted, layout.frames + cell * cell_size, (size_t)cell_size * sizeof *shifted);
        remember_frame(&layout, shifted, newest, steps == 0);
        for (npy_intp k = 0; k < layout.size; k++)
            *observed++ = shifted[layout.columns[k]];
        now.steps[0] = (int32_t)((uint32_t)steps + 1);
        scatter(&now, MEMORY_FIELDS, COUNT(MEMORY_FIELDS), after, cell);
    }
    return end(&call, Py_BuildValue("(OOO)", frames, memory, observation));
}
