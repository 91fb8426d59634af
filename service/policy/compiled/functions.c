/* Taken from numpy's own functions: their loops over doubles. */
#include "functions.h"

#include "arrays.h"
#include "loading.h"

#include <numpy/ufuncobject.h>

typedef struct {
    PyUFuncGenericFunction loop;
    void *data;
} Function;

static Function sine, cosine, arctangent2, hypotenuse2;

static void of_one(const Function *function, const double *numbers, double *out, intptr_t count)
{
    char *arguments[] = {(char *)numbers, (char *)out};
    const npy_intp dimension = count, strides[] = {sizeof(double), sizeof(double)};
    function->loop(arguments, &dimension, strides, function->data);
}

static double of_two(const Function *function, double first, double second)
{
    double out;
    char *arguments[] = {(char *)&first, (char *)&second, (char *)&out};
    const npy_intp dimension = 1, strides[] = {sizeof first, sizeof second, sizeof out};
    function->loop(arguments, &dimension, strides, function->data);
    return out;
}

void sines(const double *angles, double *out, intptr_t count) { of_one(&sine, angles, out, count); }
void cosines(const double *angles, double *out, intptr_t count) { of_one(&cosine, angles, out, count); }
double arctangent(double y, double x) { return of_two(&arctangent2, y, x); }
double hypotenuse(double x, double y) { return of_two(&hypotenuse2, x, y); }

/* Take the loop over doubles of one of numpy's functions. Return -1 with an exception if numpy has none. */
static int take_loop(PyObject *numpy, const char *name, Function *function)
{
    PyObject *found = PyObject_GetAttrString(numpy, name);
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
                Py_DECREF(found); /* the module numpy keeps it */
                return 0;
            }
        }
    }
    Py_DECREF(found);
    PyErr_Format(PyExc_ImportError, "numpy.%s has no loop over doubles", name);
    return -1;
}

int load_functions(PyObject *numpy)
{
    import_umath1(-1);
    return take_loop(numpy, "sin", &sine) < 0 || take_loop(numpy, "cos", &cosine) < 0 ||
                   take_loop(numpy, "arctan2", &arctangent2) < 0 || take_loop(numpy, "hypot", &hypotenuse2) < 0
               ? -1
               : 0;
}
