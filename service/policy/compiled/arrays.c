#include "arrays.h"

#include <string.h>

#include "functions.h"

PyObject *hold(Call *call, PyObject *object)
{
    if (object != NULL)
        call->held[call->count++] = object;
    return object;
}

PyObject *end(Call *call, PyObject *result)
{
    while (call->count > 0)
        Py_DECREF(call->held[--call->count]);
    return result;
}

static int type_of(Kind kind)
{
    switch (kind) {
    case TRUTH:
        return NPY_BOOL;
    case INTEGER:
        return NPY_INT32;
    case SINGLE:
        return NPY_FLOAT;
    default:
        return NPY_DOUBLE;
    }
}

static size_t bytes_of(const Field *field)
{
    const size_t sizes[] = {sizeof(unsigned char), sizeof(int32_t), sizeof(float), sizeof(double)};
    return (size_t)field->size * sizes[field->kind];
}

PyArrayObject *take(Call *call, PyObject *given, const char *name, Kind kind)
{
    PyObject *array = hold(call, PyArray_FROM_OTF(given, type_of(kind), NPY_ARRAY_CARRAY_RO));
    if (array == NULL && PyErr_ExceptionMatches(PyExc_TypeError))
        PyErr_Format(PyExc_TypeError, "%s has another type", name);
    return (PyArrayObject *)array;
}

/* Return whether an array has `before` dimensions, the batch's, and those that follow. */
static int fits(const Call *call, PyArrayObject *array, int before, int dimensions, const npy_intp *further)
{
    if (PyArray_NDIM(array) != before + call->dimensions + dimensions)
        return 0;
    const npy_intp *shape = PyArray_DIMS(array) + before;
    for (int k = 0; k < call->dimensions; k++)
        if (shape[k] != call->shape[k])
            return 0;
    for (int k = 0; k < dimensions; k++)
        if (shape[call->dimensions + k] != further[k])
            return 0;
    return 1;
}

const char *take_field(Call *call, PyObject *given, const Field *field)
{
    const npy_intp size = field->size;
    PyArrayObject *array = take(call, given, field->name, field->kind);
    if (array == NULL)
        return NULL;
    if (fits(call, array, 0, size > 1, &size))
        return PyArray_BYTES(array);
    PyErr_Format(PyExc_TypeError, "%s has another shape", field->name);
    return NULL;
}

PyObject *first_of(PyObject *given)
{
    return PyTuple_Check(given) && PyTuple_Size(given) > 0 ? PyTuple_GetItem(given, 0) : given;
}

int take_fields(Call *call, PyObject *tuple, const Field *fields, Py_ssize_t count, const char **rows)
{
    if (!PyTuple_Check(tuple) || PyTuple_Size(tuple) != count) {
        PyErr_Format(PyExc_TypeError, "not a tuple of %zd arrays", count);
        return -1;
    }
    for (Py_ssize_t k = 0; k < count; k++)
        if ((rows[k] = take_field(call, PyTuple_GetItem(tuple, k), &fields[k])) == NULL)
            return -1;
    return 0;
}

int take_batch(Call *call, PyObject *given, const char *name, int size)
{
    const PyArrayObject *array = (PyArrayObject *)given;
    if (!PyArray_Check(given) || PyArray_NDIM(array) < (size > 1) || PyArray_NDIM(array) > MOST_DIMENSIONS - 2 ||
        (size > 1 && PyArray_DIM(array, PyArray_NDIM(array) - 1) != size)) {
        PyErr_Format(PyExc_TypeError, "%s has another shape", name);
        return -1;
    }
    call->dimensions = PyArray_NDIM(array) - (size > 1);
    call->n = 1;
    for (int k = 0; k < call->dimensions; k++)
        call->n *= call->shape[k] = PyArray_DIM(array, k);
    return 0;
}

int take_window(Call *call, PyObject *given, Window *window)
{
    const npy_intp size = 6;
    PyArrayObject *array = take(call, given, "wrench_window", NUMBER);
    if (array == NULL)
        return -1;
    if (fits(call, array, 1, 1, &size) && PyArray_DIM(array, 0) > 0) {
        *window = (Window){PyArray_DATA(array), PyArray_DIM(array, 0), call->n};
        return 0;
    }
    PyErr_SetString(PyExc_TypeError, "wrench_window has another shape");
    return -1;
}

const float *take_frames(Call *call, PyObject *given, npy_intp width, npy_intp *depth)
{
    PyArrayObject *array = take(call, given, "frames", SINGLE);
    if (array == NULL)
        return NULL;
    *depth = PyArray_NDIM(array) == call->dimensions + 2 ? PyArray_DIM(array, call->dimensions) : 0;
    const npy_intp rows[] = {*depth, width};
    if (*depth > 0 && fits(call, array, 0, 2, rows))
        return PyArray_DATA(array);
    PyErr_SetString(PyExc_TypeError, "frames has another shape");
    return NULL;
}

PyObject *make(const Call *call, Kind kind, int dimensions, const npy_intp *further)
{
    npy_intp shape[MOST_DIMENSIONS];
    memcpy(shape, call->shape, (size_t)call->dimensions * sizeof *shape);
    memcpy(shape + call->dimensions, further, (size_t)dimensions * sizeof *shape);
    return PyArray_SimpleNew(call->dimensions + dimensions, shape, type_of(kind));
}

PyObject *make_fields(const Call *call, const Field *fields, Py_ssize_t count, char **rows)
{
    PyObject *tuple = PyTuple_New(count);
    for (Py_ssize_t k = 0; tuple != NULL && k < count; k++) {
        const npy_intp size = fields[k].size;
        PyObject *array = make(call, fields[k].kind, size > 1, &size);
        if (array == NULL || PyTuple_SetItem(tuple, k, array) < 0) {
            Py_DECREF(tuple);
            return NULL;
        }
        rows[k] = PyArray_BYTES((PyArrayObject *)array);
    }
    return tuple;
}

void gather(void *structure, const Field *fields, Py_ssize_t count, const char *const *rows, npy_intp cell)
{
    for (Py_ssize_t k = 0; k < count; k++) {
        const size_t bytes = bytes_of(&fields[k]);
        memcpy((char *)structure + fields[k].place, rows[k] + (size_t)cell * bytes, bytes);
    }
}

void scatter(const void *structure, const Field *fields, Py_ssize_t count, char *const *rows, npy_intp cell)
{
    for (Py_ssize_t k = 0; k < count; k++) {
        const size_t bytes = bytes_of(&fields[k]);
        memcpy(rows[k] + (size_t)cell * bytes, (const char *)structure + fields[k].place, bytes);
    }
}

void *scratch(Call *call, npy_intp count, size_t bytes)
{
    npy_intp size = count * (npy_intp)bytes;
    PyObject *array = hold(call, PyArray_SimpleNew(1, &size, NPY_BYTE));
    return array == NULL ? NULL : PyArray_DATA((PyArrayObject *)array);
}

const double *turns(Call *call, const double *angles, double sign)
{
    double *cosine = scratch(call, call->n, 3 * sizeof *cosine);
    if (cosine == NULL)
        return NULL;
    double *turned = cosine + 2 * call->n;
    for (npy_intp cell = 0; cell < call->n; cell++)
        turned[cell] = sign * angles[cell];
    cosines(turned, cosine, call->n);
    sines(turned, cosine + call->n, call->n);
    return cosine;
}

int has(Py_ssize_t count, Py_ssize_t wanted)
{
    if (count == wanted)
        return 1;
    PyErr_Format(PyExc_TypeError, "%zd arguments, not %zd", count, wanted);
    return 0;
}
