/* The functions of the module that run a step, and the constants that they take. */
#ifndef CALLS_H
#define CALLS_H

#include "action.h"
#include "arrays.h"
#include "bounds.h"
#include "lock.h"
#include "observation.h"

/* What `act` takes of `Seen` and `StepState` beside window and lock */
#define DUE(X) \
    X(position, NUMBER, 3) \
    X(yaw, NUMBER, 1) \
    X(tilt, NUMBER, 2) \
    X(z_floor, NUMBER, 1) \
    X(target_position, NUMBER, 3) \
    X(target_yaw, NUMBER, 1) \
    X(action, NUMBER, 4)

/* What it returns beside lock and bounds: `Decision.displacement`, `StepState.previous_action` */
#define MOVED(X) \
    X(displacement, NUMBER, 4) \
    X(unit, NUMBER, 4)

typedef struct {
    DUE(MEMBER)
} Due;

typedef struct {
    MOVED(MEMBER)
} Moved;

typedef struct {
    LockConstants lock;
    BoundsConstants bounds;
    ActionConstants action;
    ObservationConstants observation;
} Constants;

/* Take the constants from an array of their size. Return NULL with an exception if it is not one, or if its numbers
   cannot be followed. */
const Constants *take_constants(PyObject *given);

/* `PolicyStep.observe` and `PolicyStep.act`; compiled/__init__.py has their arguments. */
PyObject *observe(PyObject *self, PyObject *const *given, Py_ssize_t count);
PyObject *act(PyObject *self, PyObject *const *given, Py_ssize_t count);

/* numpy's `matmul` */
extern PyObject *matmul;

#endif
