/* The loops over doubles of numpy's own functions on this machine, for the compiled extensions: libm's sine may differ
   in the last bit, another LAPACK's inverse too. */
#ifndef LOOPS_H
#define LOOPS_H

#include <stdint.h>
#include <stdio.h> /* numpy names FILE */

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#ifndef NPY_NO_DEPRECATED_API
#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#endif
#include <numpy/ndarraytypes.h>
#include <numpy/ufuncobject.h>

typedef struct {
    PyUFuncGenericFunction loop;
    void *data;
} Loop;

static inline void loop_of_one(const Loop *function, const double *numbers, double *out, intptr_t count)
{
    char *arguments[] = {(char *)numbers, (char *)out};
    const npy_intp dimension = count, strides[] = {sizeof(double), sizeof(double)};
    function->loop(arguments, &dimension, strides, function->data);
}

static inline double loop_of_two(const Loop *function, double first, double second)
{
    double out;
    char *arguments[] = {(char *)&first, (char *)&second, (char *)&out};
    const npy_intp dimension = 1, strides[] = {sizeof first, sizeof second, sizeof out};
    function->loop(arguments, &dimension, strides, function->data);
    return out;
}

/* Take the loop of a function of a module, which keeps it. Call `import_umath1` before. Return -1 with an exception if
   there is none. */
static inline int loop_take(const char *module, const char *name, Loop *loop)
{
    PyObject *holder = PyImport_ImportModule(module);
    PyObject *found = holder == NULL ? NULL : PyObject_GetAttrString(holder, name);
    Py_XDECREF(holder);
    if (found == NULL)
        return -1;
    if (PyObject_TypeCheck(found, &PyUFunc_Type)) {
        const PyUFuncObject *ufunc = (PyUFuncObject *)found;
        for (int k = 0; k < ufunc->ntypes && ufunc->functions != NULL; k++) {
            int doubles = 1;
            for (int argument = 0; argument < ufunc->nargs; argument++)
                doubles &= ufunc->types[k * ufunc->nargs + argument] == NPY_DOUBLE;
            if (doubles && ufunc->functions[k] != NULL) {
                *loop = (Loop){ufunc->functions[k], ufunc->data == NULL ? NULL : (void *)ufunc->data[k]};
                Py_DECREF(found);
                return 0;
            }
        }
    }
    Py_DECREF(found);
    PyErr_Format(PyExc_ImportError, "%s.%s has no loop over doubles", module, name);
    return -1;
}

#endif
