#include "arguments.h"

#include <stddef.h>

static int number_of(Kind kind)
{
    switch (kind) {
    case TRUTH:
        return NPY_BOOL;
    case INTEGER:
        return NPY_INT64;
    case SINGLE:
        return NPY_FLOAT;
    default:
        return NPY_DOUBLE;
    }
}

int take_rows(PyObject *given, const Field *field, Rows *rows, npy_intp *n)
{
    if (!PyArray_Check(given)) {
        PyErr_Format(PyExc_TypeError, "%s is not an array", field->name);
        return -1;
    }
    PyArrayObject *array = (PyArrayObject *)given;
    int dimensions = PyArray_NDIM(array);
    npy_intp size = 1, step = PyArray_ITEMSIZE(array);
    int packed = dimensions > 0 && PyArray_TYPE(array) == number_of(field->kind) && PyArray_ISBEHAVED_RO(array);
    for (int k = dimensions - 1; packed && k > 0; k--) {
        packed = PyArray_DIM(array, k) == 1 || PyArray_STRIDE(array, k) == step;
        size *= PyArray_DIM(array, k);
        step *= PyArray_DIM(array, k);
    }
    if (packed && *n < 0)
        *n = PyArray_DIM(array, 0);
    if (!packed || PyArray_DIM(array, 0) != *n || (field->size < 0 ? size < -field->size : size != field->size)) {
        PyErr_Format(PyExc_TypeError, "%s has another type, shape or layout", field->name);
        return -1;
    }
    if (field->access == WRITTEN && !PyArray_ISWRITEABLE(array)) {
        PyErr_Format(PyExc_TypeError, "%s is read-only", field->name);
        return -1;
    }
    *rows = (Rows){PyArray_BYTES(array), PyArray_STRIDE(array, 0), size};
    return 0;
}

int take_all(PyObject *tuple, const Field *fields, Py_ssize_t count, Rows *rows, npy_intp *n)
{
    if (!PyTuple_Check(tuple) || PyTuple_Size(tuple) != count) {
        PyErr_Format(PyExc_TypeError, "not a tuple of %zd arrays", count);
        return -1;
    }
    for (Py_ssize_t k = 0; k < count; k++)
        if (take_rows(PyTuple_GetItem(tuple, k), &fields[k], &rows[k], n) < 0)
            return -1;
    return 0;
}

const void *take_constants(PyObject *given, size_t bytes)
{
    if (PyArray_Check(given)) {
        PyArrayObject *array = (PyArrayObject *)given;
        if (PyArray_TYPE(array) == NPY_DOUBLE && PyArray_ISCARRAY_RO(array) && (size_t)PyArray_NBYTES(array) == bytes)
            return PyArray_DATA(array);
    }
    PyErr_SetString(PyExc_TypeError, "the constants are not an array of their size");
    return NULL;
}

/* `take_constants` of those where the number at `divisor` bytes divides ticks. */
static const void *take_dividing(PyObject *given, size_t bytes, size_t divisor)
{
    const char *constants = take_constants(given, bytes);
    if (constants == NULL)
        return NULL;
    const double number = *(const double *)(constants + divisor);
    if (number >= 1.0 && number <= INT32_MAX)
        return constants;
    PyErr_SetString(PyExc_ValueError, "a period in the constants has no ticks");
    return NULL;
}

const ArmConstants *take_arm(PyObject *given)
{
    return take_dividing(given, sizeof(ArmConstants), offsetof(ArmConstants, kinematics_ticks));
}

const CellsConstants *take_cells(PyObject *given)
{
    return take_dividing(given, sizeof(CellsConstants), offsetof(CellsConstants, estimate_ticks));
}

Py_ssize_t take_slot(PyObject *given, const Sensor *sensor)
{
    const Py_ssize_t slot = PyLong_AsSsize_t(given);
    if (slot >= 0 && slot < sensor_slots(sensor))
        return slot;
    if (!PyErr_Occurred())
        PyErr_Format(PyExc_ValueError, "there is no slot %zd", slot);
    return -1;
}

int has(Py_ssize_t count, Py_ssize_t wanted)
{
    if (count == wanted)
        return 1;
    PyErr_Format(PyExc_TypeError, "%zd arguments, not %zd", count, wanted);
    return 0;
}
