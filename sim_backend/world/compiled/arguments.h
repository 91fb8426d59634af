/* What Python hands over, checked: arrays with one row per cell, constants, slots. */
#ifndef ARGUMENTS_H
#define ARGUMENTS_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdio.h> /* numpy names FILE */

#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#define PY_ARRAY_UNIQUE_SYMBOL TICK_ARRAY_API
#ifndef IMPORTS_ARRAYS
#define NO_IMPORT_ARRAY
#endif
#include <numpy/arrayobject.h>

#include "arm.h"
#include "cells.h"
#include "rows.h"
#include "sensor.h"

/* Take the rows of an array with `*n` rows, any number if that is negative. Return -1 with an exception if it is not
   what `field` asks for. */
int take_rows(PyObject *given, const Field *field, Rows *rows, npy_intp *n);

/* Take all arrays of a tuple; a structure of rows is an array of them. */
int take_all(PyObject *tuple, const Field *fields, Py_ssize_t count, Rows *rows, npy_intp *n);

/* Return the constants in an array of `bytes`, or NULL with an exception. */
const void *take_constants(PyObject *given, size_t bytes);

/* The same for constants that have periods, which are one tick at least. */
const ArmConstants *take_arm(PyObject *given);
const CellsConstants *take_cells(PyObject *given);

/* Take the slot of a sensor. Return -1 with an exception if it has no such slot. */
Py_ssize_t take_slot(PyObject *given, const Sensor *sensor);

/* Return whether a function has its number of arguments; set an exception if not. */
int has(Py_ssize_t count, Py_ssize_t wanted);

#endif
