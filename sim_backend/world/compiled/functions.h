/* numpy's own functions on this machine: libm's sine may differ in the last bit, another LAPACK's inverse too. */
#ifndef FUNCTIONS_H
#define FUNCTIONS_H

#include <stdint.h>

/* Take them from numpy. Return -1 with a Python exception if it lacks one. The inverse may be missing. */
int functions_take(void);

/* 1 if numpy's inverse was found. */
int functions_invert(void);

void sines(const double *angles, double *out, intptr_t count);
void cosines(const double *angles, double *out, intptr_t count);
double arctangent(double y, double x);

/* Inverse of a matrix (6, 6); all NaN if it has none. Like the others, it may run without the interpreter's lock. */
void inverse6(const double *matrix, double *out);

#endif
