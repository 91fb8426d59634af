/* Arrays of numpy as arguments and results: any batch shape in front, packed. */
#ifndef ARRAYS_H
#define ARRAYS_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdio.h> /* numpy names FILE */

#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#define PY_ARRAY_UNIQUE_SYMBOL STEP_ARRAY_API
#ifndef IMPORTS_ARRAYS
#define NO_IMPORT_ARRAY
#endif
#include <numpy/arrayobject.h>

#include "numbers.h"
#include "window.h"

#define COUNT(list) ((Py_ssize_t)(sizeof(list) / sizeof *(list)))
#define MOST_FIELDS 16
#define MOST_HELD 40
#define MOST_DIMENSIONS 8

/* Arrays of one call, which it holds until it ends, and its batch: `n` cells. */
typedef struct {
    PyObject *held[MOST_HELD];
    int count, dimensions;
    npy_intp n, shape[MOST_DIMENSIONS];
} Call;

/* Hold a new reference until the call ends; return it. */
PyObject *hold(Call *call, PyObject *object);

/* Release what the call holds; return the result. */
PyObject *end(Call *call, PyObject *result);

/* Take the batch's shape from an array with `size` numbers for each cell. Return -1 with an exception if it has none. */
int take_batch(Call *call, PyObject *given, const char *name, int size);

/* Return the first object of a tuple, else the object itself. */
PyObject *first_of(PyObject *given);

/* Take an array, packed, of a kind. Return NULL with an exception if it cannot be had. */
PyArrayObject *take(Call *call, PyObject *given, const char *name, Kind kind);

/* Take the numbers of a field for every cell of the batch; NULL with an exception if they are not of its shape. */
const char *take_field(Call *call, PyObject *given, const Field *field);

/* Take the arrays of a tuple, one for each field. Return -1 with an exception if they do not fit. */
int take_fields(Call *call, PyObject *tuple, const Field *fields, Py_ssize_t count, const char **rows);

/* Take a window (T, ..., 6), T > 0. Return -1 with an exception if that is not its shape. */
int take_window(Call *call, PyObject *given, Window *window);

/* Take frames (..., depth, width), depth > 0. Return NULL with an exception if that is not their shape. */
const float *take_frames(Call *call, PyObject *given, npy_intp width, npy_intp *depth);

/* Make an array of the batch's shape, with further dimensions. */
PyObject *make(const Call *call, Kind kind, int dimensions, const npy_intp *further);

/* Make a tuple of arrays, one for each field. */
PyObject *make_fields(const Call *call, const Field *fields, Py_ssize_t count, char **rows);

/* Copy the fields of one cell from arrays to a structure, and back. */
void gather(void *structure, const Field *fields, Py_ssize_t count, const char *const *rows, npy_intp cell);
void scatter(const void *structure, const Field *fields, Py_ssize_t count, char *const *rows, npy_intp cell);

/* Return memory for `count` items until the call ends; NULL with an exception if there is none. */
void *scratch(Call *call, npy_intp count, size_t bytes);

/* Return cosines, then sines, of n angles times `sign`; NULL with an exception without memory. */
const double *turns(Call *call, const double *angles, double sign);

/* Return whether a function has its number of arguments; set an exception if not. */
int has(Py_ssize_t count, Py_ssize_t wanted);

#endif
