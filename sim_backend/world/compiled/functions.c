#include "functions.h"

#include <stdio.h> /* which numpy needs */

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#include <numpy/ndarraytypes.h>
#include <numpy/ufuncobject.h>

typedef struct {
    PyUFuncGenericFunction loop;
    void *data;
} Function;

static Function sine, cosine, arctangent2, inverse;

void sines(const double *angles, double *out, intptr_t count)
{
    char *arguments[] = {(char *)angles, (char *)out};
    const npy_intp dimension = count, strides[] = {sizeof(double), sizeof(double)};
    sine.loop(arguments, &dimension, strides, sine.data);
}

void cosines(const double *angles, double *out, intptr_t count)
{
    char *arguments[] = {(char *)angles, (char *)out};
    const npy_intp dimension = count, strides[] = {sizeof(double), sizeof(double)};
    cosine.loop(arguments, &dimension, strides, cosine.data);
}

double arctangent(double y, double x)
{
    double out;
    char *arguments[] = {(char *)&y, (char *)&x, (char *)&out};
    const npy_intp dimension = 1, strides[] = {sizeof y, sizeof x, sizeof out};
    arctangent2.loop(arguments, &dimension, strides, arctangent2.data);
    return out;
}

void inverse6(const double *matrix, double *out)
{
    enum { ROW = 6 * sizeof(double), ALL = 6 * ROW };
    char *arguments[] = {(char *)matrix, (char *)out};
    const npy_intp dimensions[] = {1, 6}, strides[] = {ALL, ALL, ROW, sizeof(double), ROW, sizeof(double)};
    inverse.loop(arguments, dimensions, strides, inverse.data);
}

int functions_invert(void) { return inverse.loop != NULL; }

/* Take the loop over doubles of one of numpy's functions. Return -1 with an exception if numpy has none. */
static int take(const char *module, const char *name, Function *function)
{
    PyObject *numpy = PyImport_ImportModule(module);
    PyObject *found = numpy == NULL ? NULL : PyObject_GetAttrString(numpy, name);
    Py_XDECREF(numpy);
    if (found == NULL)
        return -1;
    if (PyObject_TypeCheck(found, &PyUFunc_Type)) {
        const PyUFuncObject *ufunc = (PyUFuncObject *)found;
        for (int k = 0; k < ufunc->ntypes && ufunc->functions != NULL; k++) {
            int doubles = 1;
            for (int argument = 0; argument < ufunc->nargs; argument++)
                doubles &= ufunc->types[k * ufunc->nargs + argument] == NPY_DOUBLE;
            if (doubles && ufunc->functions[k] != NULL) {
                *function = (Function){ufunc->functions[k], ufunc->data == NULL ? NULL : (void *)ufunc->data[k]};
                Py_DECREF(found); /* its module keeps it */
                return 0;
            }
        }
    }
    Py_DECREF(found);
    PyErr_Format(PyExc_ImportError, "%s.%s has no loop over doubles", module, name);
    return -1;
}

int functions_take(void)
{
    import_umath1(-1);
    if (take("numpy", "sin", &sine) < 0 || take("numpy", "cos", &cosine) < 0 ||
        take("numpy", "arctan2", &arctangent2) < 0)
        return -1;
    if (take("numpy.linalg._umath_linalg", "inv", &inverse) < 0)
        PyErr_Clear(); /* a private place; only `advance` needs it */
    return 0;
}
