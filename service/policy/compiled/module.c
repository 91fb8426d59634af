/* The module `_step`: the policy step of any number of cells. */
#define IMPORTS_ARRAYS
#include "calls.h"
#include "functions.h"
#include "pose.h"

#define AS_FIELD(name, kind, size) {#name, kind, size, 0},
#define AS_CONSTANT(name, size) {#name, NUMBER, size, 0},

static const Field DUE_FIELDS[] = {DUE(AS_FIELD)};
static const Field LOCK_STATE_FIELDS[] = {LOCK_STATE(AS_FIELD)};
static const Field LOCK_OUTPUT_FIELDS[] = {LOCK_OUTPUT(AS_FIELD)};
static const Field BOUNDED_FIELDS[] = {BOUNDED(AS_FIELD)};
static const Field MEMORY_FIELDS[] = {MEMORY(AS_FIELD)};
static const Field MEASUREMENT_FIELDS[] = {MEASUREMENT(AS_FIELD)};
static const Field LOCK_CONSTANT_FIELDS[] = {LOCK_CONSTANTS(AS_CONSTANT)};
static const Field BOUNDS_CONSTANT_FIELDS[] = {BOUNDS_CONSTANTS(AS_CONSTANT)};
static const Field ACTION_CONSTANT_FIELDS[] = {ACTION_CONSTANTS(AS_CONSTANT)};
static const Field OBSERVATION_CONSTANT_FIELDS[] = {OBSERVATION_CONSTANTS(AS_CONSTANT)};
static const Field ENTRY_FIELDS[] = {ENTRIES(AS_CONSTANT)};

/* Return the constants if those that count or address something can; else NULL with an exception. */
static const Constants *are_sound(const Constants *constants)
{
    const double samples = constants->observation.window_samples[0];
    int sound = samples >= 1.0 && samples <= INT32_MAX;
    for (int k = 0; k < 4; k++)
        sound &= constants->action.column[k] >= 0.0 && constants->action.column[k] < 4.0;
    if (sound)
        return constants;
    PyErr_SetString(PyExc_ValueError, "the constants have no such column, or a window of no samples");
    return NULL;
}

const Constants *take_constants(PyObject *given)
{
    if (PyArray_Check(given)) {
        PyArrayObject *array = (PyArrayObject *)given;
        if (PyArray_TYPE(array) == NPY_DOUBLE && PyArray_ISCARRAY_RO(array) &&
            (size_t)PyArray_NBYTES(array) == sizeof(Constants))
            return are_sound(PyArray_DATA(array));
    }
    PyErr_SetString(PyExc_TypeError, "the constants are not an array of their size");
    return NULL;
}

static PyObject *split(PyObject *self, PyObject *given)
{
    (void)self;
    static const Field ROTVEC = {"rotvec", NUMBER, 3, 0}, SPLIT[] = {{"yaw", NUMBER, 1, 0}, {"tilt", NUMBER, 2, 0}};
    Call call = {.count = 0};
    char *out[2];
    const char *rotvec;
    if (take_batch(&call, given, "rotvec", 3) < 0 || (rotvec = take_field(&call, given, &ROTVEC)) == NULL)
        return end(&call, NULL);
    PyObject *made = make_fields(&call, SPLIT, COUNT(SPLIT), out);
    for (npy_intp cell = 0; made != NULL && cell < call.n; cell++)
        yaw_and_tilt((const double *)rotvec + 3 * cell, (double *)out[0] + cell, (double *)out[1] + 2 * cell);
    return end(&call, made);
}

static PyObject *point_down(PyObject *self, PyObject *given)
{
    (void)self;
    static const Field YAW = {"yaw", NUMBER, 1, 0}, ROTVEC = {"rotvec", NUMBER, 3, 0};
    Call call = {.count = 0};
    char *out[1];
    const char *yaw;
    PyArrayObject *array = take(&call, given, "yaw", NUMBER);
    if (array == NULL || take_batch(&call, (PyObject *)array, "yaw", 1) < 0 ||
        (yaw = take_field(&call, (PyObject *)array, &YAW)) == NULL)
        return end(&call, NULL);
    PyObject *made = make_fields(&call, &ROTVEC, 1, out);
    for (npy_intp cell = 0; made != NULL && cell < call.n; cell++)
        rotvec_from_yaw(((const double *)yaw)[cell], (double *)out[0] + 3 * cell);
    PyObject *result = made == NULL ? NULL : PyTuple_GetItem(made, 0);
    Py_XINCREF(result);
    Py_XDECREF(made);
    return end(&call, result);
}

#define FAST(function) {#function, (PyCFunction)(void (*)(void))function, METH_FASTCALL, NULL}

static PyMethodDef methods[] = {
    FAST(observe),
    FAST(act),
    {"yaw_and_tilt", split, METH_O, NULL},
    {"rotvec_from_yaw", point_down, METH_O, NULL},
    {NULL},
};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, .m_name = "_step", .m_size = -1, .m_methods = methods};

/* Add names and sizes, in order. */
static int add(PyObject *module, const char *name, const Field *fields, Py_ssize_t count)
{
    PyObject *sizes = PyDict_New();
    for (Py_ssize_t k = 0; sizes != NULL && k < count; k++) {
        PyObject *size = PyLong_FromSsize_t(fields[k].size);
        if (size == NULL || PyDict_SetItemString(sizes, fields[k].name, size) < 0)
            return -1;
        Py_DECREF(size);
    }
    int failed = sizes == NULL || PyModule_AddObjectRef(module, name, sizes) < 0;
    Py_XDECREF(sizes);
    return failed ? -1 : 0;
}

PyMODINIT_FUNC PyInit__step(void)
{
    import_array();
    PyObject *numpy = PyImport_ImportModule("numpy");
    if (numpy == NULL || load_functions() < 0 || (matmul = PyObject_GetAttrString(numpy, "matmul")) == NULL)
        return NULL;
    PyObject *module = PyModule_Create(&definition);
    if (module == NULL || PyModule_AddStringConstant(module, "SOURCES", SOURCES) < 0 ||
        add(module, "LOCK_CONSTANTS", LOCK_CONSTANT_FIELDS, COUNT(LOCK_CONSTANT_FIELDS)) < 0 ||
        add(module, "BOUNDS_CONSTANTS", BOUNDS_CONSTANT_FIELDS, COUNT(BOUNDS_CONSTANT_FIELDS)) < 0 ||
        add(module, "ACTION_CONSTANTS", ACTION_CONSTANT_FIELDS, COUNT(ACTION_CONSTANT_FIELDS)) < 0 ||
        add(module, "OBSERVATION_CONSTANTS", OBSERVATION_CONSTANT_FIELDS, COUNT(OBSERVATION_CONSTANT_FIELDS)) < 0 ||
        add(module, "DUE", DUE_FIELDS, COUNT(DUE_FIELDS)) < 0 ||
        add(module, "MEASUREMENT", MEASUREMENT_FIELDS, COUNT(MEASUREMENT_FIELDS)) < 0 ||
        add(module, "MEMORY", MEMORY_FIELDS, COUNT(MEMORY_FIELDS)) < 0 ||
        add(module, "LOCK_STATE", LOCK_STATE_FIELDS, COUNT(LOCK_STATE_FIELDS)) < 0 ||
        add(module, "LOCK_OUTPUT", LOCK_OUTPUT_FIELDS, COUNT(LOCK_OUTPUT_FIELDS)) < 0 ||
        add(module, "BOUNDED", BOUNDED_FIELDS, COUNT(BOUNDED_FIELDS)) < 0 ||
        add(module, "ENTRIES", ENTRY_FIELDS, COUNT(ENTRY_FIELDS)) < 0)
        return NULL;
    return module;
}
