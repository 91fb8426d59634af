/* The module `_tick`: calls the arithmetic of the other files with what Python hands over. */
#define IMPORTS_ARRAYS
#include "arguments.h"

#include "advance.h"
#include "functions.h"
#include "joint_sense.h"
#include "telling.h"

static const Field ARM[] = {ARM_FIELDS(AS_FIELD)};
static const Field MEASURED[] = {MEASURED_FIELDS(AS_FIELD)};
static const Field SENSOR[] = {SENSOR_FIELDS(AS_FIELD)};
static const Field CELLS[] = {CELLS_FIELDS(AS_FIELD)};
static const Field DRIVES[] = {DRIVES_FIELDS(AS_FIELD)};
static const Field EFFORT[] = {EFFORT_FIELDS(AS_FIELD)};
static const Field TELLING[] = {TELLING_FIELDS(AS_FIELD)};
static const Field REPORT[] = {REPORT_FIELDS(AS_FIELD)};
static const Field TOGETHER[] = {TOGETHER_FIELDS(AS_FIELD)};
static const Field INVERSES = {"inverses", NUMBER, 36, READ};
static const Field SET_POINTS = {"set_points", NUMBER, 6, WRITTEN};
static const Field CARRIED = {"carried", NUMBER, 6, READ};
static const Field SENSED = {"sensed", NUMBER, 6, READ};
static const Field ROTATION = {"rotation", NUMBER, 9, READ};
static const Field UNZEROED = {"unzeroed", NUMBER, 6, WRITTEN};
static const Constant ARM_CONSTANTS[] = {ARM_NUMBERS(AS_CONSTANT) ARM_VECTORS(AS_CONSTANTS)};
static const Constant SENSOR_CONSTANTS[] = {SENSOR_NUMBERS(AS_CONSTANT) SENSOR_VECTORS(AS_CONSTANTS)};
static const Constant DRIVES_CONSTANTS[] = {DRIVES_NUMBERS(AS_CONSTANT) DRIVES_VECTORS(AS_CONSTANTS)};
static const Constant CELLS_CONSTANTS[] = {CELLS_NUMBERS(AS_CONSTANT)};
static const Constant TOGETHER_CONSTANTS[] = {TOGETHER_NUMBERS(AS_CONSTANT)};

#define COUNT(list) ((Py_ssize_t)(sizeof(list) / sizeof *(list)))
#define CALL ((sizeof(Advance) + sizeof(double) - 1) / sizeof(double)) /* in numbers */

/* --- functions ---------------------------------------------------------------------------------------------------- */

static PyObject *lead(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    (void)self;
    Arm arm;
    Measured measured;
    npy_intp n = -1;
    if (!has(count, 2 + COUNT(MEASURED)) || take_all(given[0], ARM, COUNT(ARM), (Rows *)&arm, &n) < 0)
        return NULL;
    const ArmConstants *constants = take_arm(given[1]);
    if (constants == NULL)
        return NULL;
    for (Py_ssize_t k = 0; k < COUNT(MEASURED); k++)
        if (take_rows(given[2 + k], &MEASURED[k], (Rows *)&measured + k, &n) < 0)
            return NULL;
    Py_ssize_t due = 0;
    for (npy_intp cell = 0; cell < n; cell++)
        due += arm_lead(&arm, constants, &measured, cell, due);
    return PyLong_FromSsize_t(due);
}

static PyObject *follow(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    (void)self;
    Arm arm;
    Rows inverses, set_points;
    npy_intp n = -1, due = 0, inverted = -1;
    if (!has(count, 4) || take_all(given[0], ARM, COUNT(ARM), (Rows *)&arm, &n) < 0)
        return NULL;
    const ArmConstants *constants = take_arm(given[1]);
    if (constants == NULL)
        return NULL;
    for (npy_intp cell = 0; cell < n; cell++)
        due += *integer(arm.phase, cell) == 0;
    if (take_rows(given[2], &INVERSES, &inverses, &inverted) < 0 ||
        take_rows(given[3], &SET_POINTS, &set_points, &n) < 0)
        return NULL;
    if (inverted < due) {
        PyErr_Format(PyExc_TypeError, "%zd inverses, not %zd", inverted, due);
        return NULL;
    }
    for (npy_intp cell = due = 0; cell < n; cell++)
        due += arm_follow(&arm, constants, cell, due, numbers(inverses, due), numbers(set_points, cell));
    Py_RETURN_NONE;
}

static PyObject *sense(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    (void)self;
    Sensor sensor;
    Rows carried;
    npy_intp n = -1;
    if (!has(count, 4) || take_all(given[0], SENSOR, COUNT(SENSOR), (Rows *)&sensor, &n) < 0)
        return NULL;
    const SensorConstants *constants = take_constants(given[1], sizeof *constants);
    if (constants == NULL || take_rows(given[2], &CARRIED, &carried, &n) < 0)
        return NULL;
    const Py_ssize_t slot = take_slot(given[3], &sensor);
    if (slot < 0)
        return NULL;
    for (npy_intp cell = 0; cell < n; cell++)
        sensor_sense(&sensor, constants, numbers(carried, cell), slot, cell);
    Py_RETURN_NONE;
}

static PyObject *compensate(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    (void)self;
    Sensor sensor;
    Rows sensed, rotation;
    npy_intp n = -1;
    if (!has(count, 4) || take_all(given[0], SENSOR, COUNT(SENSOR), (Rows *)&sensor, &n) < 0)
        return NULL;
    const SensorConstants *constants = take_constants(given[1], sizeof *constants);
    if (constants == NULL || take_rows(given[2], &SENSED, &sensed, &n) < 0 ||
        take_rows(given[3], &ROTATION, &rotation, &n) < 0)
        return NULL;
    for (npy_intp cell = 0; cell < n; cell++)
        sensor_compensate(&sensor, constants, numbers(sensed, cell), numbers(rotation, cell), cell);
    Py_RETURN_NONE;
}

static PyObject *unzeroed(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    (void)self;
    Sensor sensor;
    Rows rotation, out;
    npy_intp n = -1;
    if (!has(count, 4) || take_all(given[0], SENSOR, COUNT(SENSOR), (Rows *)&sensor, &n) < 0)
        return NULL;
    const SensorConstants *constants = take_constants(given[1], sizeof *constants);
    if (constants == NULL || take_rows(given[2], &ROTATION, &rotation, &n) < 0 ||
        take_rows(given[3], &UNZEROED, &out, &n) < 0)
        return NULL;
    sensor_unzeroed(&sensor, constants, rotation, out, n);
    Py_RETURN_NONE;
}

static PyObject *feel(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    (void)self;
    Drives drives;
    Effort effort;
    npy_intp n = -1;
    if (!has(count, 4) || take_all(given[0], DRIVES, COUNT(DRIVES), (Rows *)&drives, &n) < 0)
        return NULL;
    const DrivesConstants *constants = take_constants(given[1], sizeof *constants);
    if (constants == NULL || take_all(given[2], EFFORT, COUNT(EFFORT) - 1, (Rows *)&effort, &n) < 0 ||
        take_rows(given[3], &EFFORT[COUNT(EFFORT) - 1], &effort.noise, &n) < 0)
        return NULL;
    drives_read(&drives, constants, &effort, n);
    Py_RETURN_NONE;
}

static PyObject *tell(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    (void)self;
    Telling telling;
    Report report;
    npy_intp n = -1;
    if (!has(count, 2) || take_all(given[0], TELLING, COUNT(TELLING), (Rows *)&telling, &n) < 0 ||
        take_all(given[1], REPORT, COUNT(REPORT), (Rows *)&report, &n) < 0)
        return NULL;
    telling_fill(&telling, &report, n);
    Py_RETURN_NONE;
}

static PyObject *measure(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    (void)self;
    Cells cells;
    npy_intp n = -1;
    if (!has(count, 2) || take_all(given[0], CELLS, COUNT(CELLS), (Rows *)&cells, &n) < 0)
        return NULL;
    const CellsConstants *constants = take_cells(given[1]);
    if (constants == NULL)
        return NULL;
    for (npy_intp cell = 0; cell < n; cell++) {
        const Physics physics = cells_physics(&cells, cell);
        cells_measure(&cells, constants, &physics, cell);
    }
    Py_RETURN_NONE;
}

static PyObject *advance(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    (void)self;
    Advance call, *kept;
    npy_intp n = -1;
    if (!has(count, 12) || take_all(given[0], ARM, COUNT(ARM), (Rows *)&call.arm, &n) < 0 ||
        (call.arm_constants = take_arm(given[1])) == NULL ||
        take_all(given[2], CELLS, COUNT(CELLS), (Rows *)&call.cells, &n) < 0 ||
        (call.cells_constants = take_cells(given[3])) == NULL ||
        take_all(given[4], SENSOR, COUNT(SENSOR), (Rows *)&call.sensor, &n) < 0 ||
        (call.sensor_constants = take_constants(given[5], sizeof *call.sensor_constants)) == NULL ||
        take_all(given[6], TOGETHER, COUNT(TOGETHER), (Rows *)&call.together, &n) < 0 ||
        (call.constants = take_constants(given[7], sizeof *call.constants)) == NULL ||
        (kept = (Advance *)take_constants(given[8], CALL * sizeof(double))) == NULL ||
        (call.slot = take_slot(given[10], &call.sensor)) < 0)
        return NULL;
    const Field readings = {"readings", NUMBER, 6 * n, WRITTEN};
    call.n = n;
    call.ticks = -1;
    if (take_rows(given[9], &readings, &call.readings, &call.ticks) < 0)
        return NULL;
    if (call.ticks < 1) {
        PyErr_SetString(PyExc_ValueError, "there are no readings to take");
        return NULL;
    }
    if (kept->open) {
        PyErr_SetString(PyExc_RuntimeError, "another thread advances these cells");
        return NULL;
    }
    *kept = call;
    advance_open(kept);
    PyObject *stepped = PyObject_CallFunction(given[11], "n", call.ticks); /* gives up the interpreter's lock */
    int whole = advance_close(kept, stepped != NULL);
    if (stepped != NULL && !whole)
        PyErr_SetString(PyExc_RuntimeError, "MuJoCo has not stepped these cells as asked: another control callback, or another thread");
    Py_XDECREF(stepped);
    if (!whole)
        return NULL;
    Py_RETURN_NONE;
}

#define FAST(function) {#function, (PyCFunction)(void (*)(void))function, METH_FASTCALL, NULL}

static PyMethodDef methods[] = {
    FAST(lead),
    FAST(follow),
    FAST(sense),
    FAST(compensate),
    FAST(unzeroed),
    FAST(measure),
    FAST(feel),
    FAST(tell),
    FAST(advance),
    {NULL},
};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, .m_name = "_tick", .m_size = -1, .m_methods = methods};

/* --- names, sizes and order for Python ---------------------------------------------------------------------------- */

static int add_fields(PyObject *module, const char *name, const Field *fields, Py_ssize_t count)
{
    PyObject *names = PyTuple_New(count);
    for (Py_ssize_t k = 0; names != NULL && k < count; k++)
        if (PyTuple_SetItem(names, k, PyUnicode_FromString(fields[k].name)) < 0)
            return -1;
    int failed = names == NULL || PyModule_AddObjectRef(module, name, names) < 0;
    Py_XDECREF(names);
    return failed ? -1 : 0;
}

static int add_constants(PyObject *module, const char *name, const Constant *constants, Py_ssize_t count)
{
    PyObject *sizes = PyDict_New();
    for (Py_ssize_t k = 0; sizes != NULL && k < count; k++) {
        PyObject *size = PyLong_FromSsize_t(constants[k].size);
        if (size == NULL || PyDict_SetItemString(sizes, constants[k].name, size) < 0)
            return -1;
        Py_DECREF(size);
    }
    int failed = sizes == NULL || PyModule_AddObjectRef(module, name, sizes) < 0;
    Py_XDECREF(sizes);
    return failed ? -1 : 0;
}

static int add_address(PyObject *module, const char *name, void *address)
{
    PyObject *number = PyLong_FromVoidPtr(address);
    int failed = number == NULL || PyModule_AddObjectRef(module, name, number) < 0;
    Py_XDECREF(number);
    return failed ? -1 : 0;
}

PyMODINIT_FUNC PyInit__tick(void)
{
    import_array();
    if (functions_take() < 0)
        return NULL;
    PyObject *module = PyModule_Create(&definition);
    if (module == NULL || PyModule_AddStringConstant(module, "SOURCES", SOURCES) < 0 ||
        add_fields(module, "ARM", ARM, COUNT(ARM)) < 0 || add_fields(module, "SENSOR", SENSOR, COUNT(SENSOR)) < 0 ||
        add_fields(module, "CELLS", CELLS, COUNT(CELLS)) < 0 ||
        add_fields(module, "DRIVES", DRIVES, COUNT(DRIVES)) < 0 ||
        add_fields(module, "TELLING", TELLING, COUNT(TELLING)) < 0 ||
        add_fields(module, "REPORT", REPORT, COUNT(REPORT)) < 0 ||
        add_fields(module, "TOGETHER", TOGETHER, COUNT(TOGETHER)) < 0 ||
        PyModule_AddIntConstant(module, "MUJOCO", advance_version()) < 0 ||
        PyModule_AddIntConstant(module, "INVERTS", functions_invert()) < 0 ||
        PyModule_AddIntConstant(module, "CALL", CALL) < 0 ||
        add_constants(module, "DRIVES_CONSTANTS", DRIVES_CONSTANTS, COUNT(DRIVES_CONSTANTS)) < 0 ||
        add_constants(module, "ARM_CONSTANTS", ARM_CONSTANTS, COUNT(ARM_CONSTANTS)) < 0 ||
        add_constants(module, "SENSOR_CONSTANTS", SENSOR_CONSTANTS, COUNT(SENSOR_CONSTANTS)) < 0 ||
        add_constants(module, "CELLS_CONSTANTS", CELLS_CONSTANTS, COUNT(CELLS_CONSTANTS)) < 0 ||
        add_constants(module, "TOGETHER_CONSTANTS", TOGETHER_CONSTANTS, COUNT(TOGETHER_CONSTANTS)) < 0 ||
        add_address(module, "CONTROL", advance_callback()) < 0 || add_address(module, "CLOCK", advance_clock()) < 0)
        return NULL;
    return module;
}
