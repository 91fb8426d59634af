#include <string.h>

#include "calls.h"

#define IN_DUE(name, kind, size) {#name, kind, size, offsetof(Due, name)},
#define IN_LOCK_STATE(name, kind, size) {#name, kind, size, offsetof(LockState, name)},
#define IN_LOCK_OUTPUT(name, kind, size) {#name, kind, size, offsetof(LockOutput, name)},
#define IN_BOUNDED(name, kind, size) {#name, kind, size, offsetof(Bounded, name)},
#define IN_MOVED(name, kind, size) {#name, kind, size, offsetof(Moved, name)},

static const Field DUE_FIELDS[] = {DUE(IN_DUE)};
static const Field LOCK_STATE_FIELDS[] = {LOCK_STATE(IN_LOCK_STATE)};
static const Field LOCK_OUTPUT_FIELDS[] = {LOCK_OUTPUT(IN_LOCK_OUTPUT)};
static const Field BOUNDED_FIELDS[] = {BOUNDED(IN_BOUNDED)};
static const Field MOVED_FIELDS[] = {MOVED(IN_MOVED)};

PyObject *matmul;

/* Return the sums of equation 3, one for each cell: numpy's product, whose order is the machine's. Where no cell feels
   an edge nobody asks for them, and they are zero. */
static const double *increments(Call *call, const LockConstants *constants, const Felt *felt)
{
    npy_intp three = 3;
    int edge = 0;
    for (npy_intp cell = 0; cell < call->n; cell++)
        edge |= felt[cell].edge;
    if (!edge) {
        double *zeros = scratch(call, call->n, sizeof *zeros);
        return zeros == NULL ? NULL : memset(zeros, 0, (size_t)call->n * sizeof *zeros);
    }
    PyObject *summands = hold(call, make(call, NUMBER, 1, &three));
    PyObject *beta1 = hold(call, PyArray_SimpleNew(1, &three, NPY_DOUBLE));
    if (summands == NULL || beta1 == NULL)
        return NULL;
    double *summand = PyArray_DATA((PyArrayObject *)summands);
    for (npy_intp cell = 0; cell < call->n; cell++)
        for (int k = 0; k < 3; k++)
            *summand++ = felt[cell].delta_n[k] + felt[cell].delta_n[3 + k];
    memcpy(PyArray_DATA((PyArrayObject *)beta1), constants->beta1, sizeof constants->beta1);
    PyObject *product = hold(call, PyObject_CallFunctionObjArgs(matmul, summands, beta1, NULL));
    PyArrayObject *sums = product == NULL ? NULL : take(call, product, "matmul", NUMBER);
    return sums == NULL ? NULL : PyArray_DATA(sums);
}

/* `PolicyStep.act` for one cell */
static void act_once(
    const Constants *constants, const Due *due, const Felt *felt, double increment, double cosine, double sine,
    Moved *moved, LockState *state, LockOutput *output, Bounded *bounded)
{
    Pose measured, asked, previous;
    action_map(&constants->action, due->action, cosine, sine, moved->displacement, moved->unit);
    lock_step(
        &constants->lock, state, due->z_floor[0], felt, increment, due->position, moved->displacement, output);
    memcpy(measured.position, due->position, sizeof measured.position);
    memcpy(asked.position, output->position, sizeof asked.position);
    memcpy(previous.position, due->target_position, sizeof previous.position);
    measured.yaw = due->yaw[0];
    asked.yaw = due->yaw[0] + output->dyaw[0];
    previous.yaw = due->target_yaw[0];
    const double tilt = sqrt(due->tilt[0] * due->tilt[0] + due->tilt[1] * due->tilt[1]);
    bounds_apply(&constants->bounds, measured, asked, &previous, tilt, bounded);
}

PyObject *act(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    (void)self;
    Call call = {.count = 0};
    Window window;
    const char *dues[MOST_FIELDS], *before[MOST_FIELDS];
    char *moves[MOST_FIELDS], *after[MOST_FIELDS], *outputs[MOST_FIELDS], *commands[MOST_FIELDS];
    const Constants *constants;
    if (!has(count, 4) || (constants = take_constants(given[0])) == NULL ||
        take_batch(&call, first_of(given[1]), "position", 3) < 0)
        return NULL;
    if (take_fields(&call, given[1], DUE_FIELDS, COUNT(DUE_FIELDS), dues) < 0 ||
        take_window(&call, given[2], &window) < 0 ||
        take_fields(&call, given[3], LOCK_STATE_FIELDS, COUNT(LOCK_STATE_FIELDS), before) < 0)
        return end(&call, NULL);
    const double *cosine = turns(&call, (const double *)dues[1], 1.0), *increment = NULL;
    double *wrench = scratch(&call, call.n, 6 * sizeof *wrench);
    Felt *felt = scratch(&call, call.n, sizeof *felt);
    PyObject *moved = hold(&call, make_fields(&call, MOVED_FIELDS, COUNT(MOVED_FIELDS), moves));
    PyObject *state = hold(&call, make_fields(&call, LOCK_STATE_FIELDS, COUNT(LOCK_STATE_FIELDS), after));
    PyObject *locked = hold(&call, make_fields(&call, LOCK_OUTPUT_FIELDS, COUNT(LOCK_OUTPUT_FIELDS), outputs));
    PyObject *bounded = hold(&call, make_fields(&call, BOUNDED_FIELDS, COUNT(BOUNDED_FIELDS), commands));
    if (cosine == NULL || wrench == NULL || felt == NULL || moved == NULL || state == NULL || locked == NULL ||
        bounded == NULL)
        return end(&call, NULL);
    window_means(&window, (ptrdiff_t)constants->observation.window_samples[0], wrench);
    for (npy_intp cell = 0; cell < call.n; cell++) {
        Due due;
        LockState now;
        gather(&due, DUE_FIELDS, COUNT(DUE_FIELDS), dues, cell);
        gather(&now, LOCK_STATE_FIELDS, COUNT(LOCK_STATE_FIELDS), before, cell);
        felt[cell] = lock_feel(&constants->lock, &now, due.position, wrench + 6 * cell);
    }
    if (constants->lock.mode[0] == PAPER && (increment = increments(&call, &constants->lock, felt)) == NULL)
        return end(&call, NULL);
    for (npy_intp cell = 0; cell < call.n; cell++) {
        Due due;
        Moved move;
        LockState now;
        LockOutput output;
        Bounded command;
        gather(&due, DUE_FIELDS, COUNT(DUE_FIELDS), dues, cell);
        gather(&now, LOCK_STATE_FIELDS, COUNT(LOCK_STATE_FIELDS), before, cell);
        act_once(
            constants, &due, &felt[cell], increment == NULL ? 0.0 : increment[cell], cosine[cell],
            cosine[call.n + cell], &move, &now, &output, &command);
        scatter(&move, MOVED_FIELDS, COUNT(MOVED_FIELDS), moves, cell);
        scatter(&now, LOCK_STATE_FIELDS, COUNT(LOCK_STATE_FIELDS), after, cell);
        scatter(&output, LOCK_OUTPUT_FIELDS, COUNT(LOCK_OUTPUT_FIELDS), outputs, cell);
        scatter(&command, BOUNDED_FIELDS, COUNT(BOUNDED_FIELDS), commands, cell);
    }
    return end(&call, Py_BuildValue("(OOOO)", moved, state, locked, bounded));
}
