/* world.py: all ticks of `World.advance`, computed by MuJoCo's control callback within one call of `Batch.step`. */
#ifndef ADVANCE_H
#define ADVANCE_H

#include "arm.h"
#include "cells.h"
#include "rows.h"
#include "sensor.h"

/* Attributes of `Together`. `before` is position, rotation, the gripper's quaternion and the time of the MuJoCo step
   before; `told` is in MuJoCo's models, where a cell's own names the call and the cell. */
#define TOGETHER_FIELDS(X) \
    X(orientation, NUMBER, 4, READ) \
    X(before, NUMBER, 17, WRITTEN) \
    X(done, INTEGER, 1, WRITTEN) \
    X(told, NUMBER, 2, WRITTEN)

#define TOGETHER_NUMBERS(X) \
    X(tcp_site) \
    X(gripper_body)

typedef struct {
    TOGETHER_FIELDS(AS_ROWS)
} Together;

typedef struct {
    TOGETHER_NUMBERS(AS_NUMBER)
} TogetherConstants;

/* One call: the arrays of all objects, the readings (ticks, n, 6) to write, and the sensors' slot before the first. Its
   memory is the world's: a step that another thread makes of the same simulations may look at it after its end. */
typedef struct {
    Arm arm;
    Cells cells;
    Sensor sensor;
    Together together;
    const ArmConstants *arm_constants;
    const CellsConstants *cells_constants;
    const SensorConstants *sensor_constants;
    const TogetherConstants *constants;
    Rows readings;
    intptr_t slot, ticks, n;
    int open;
} Advance;

/* Return the version of MuJoCo whose data `advance_callback` reads. */
int advance_version(void);

/* Return the address of the control callback. It leaves all simulations alone but those of a call under way. */
void *advance_callback(void);

/* Return the address of a clock for MuJoCo's timers that stands still. */
void *advance_clock(void);

void advance_open(Advance *advance);

/* Close a call. Return 1 if MuJoCo has made all its steps by the callback; take the last measurement then. */
int advance_close(Advance *advance, int whole);

#endif
