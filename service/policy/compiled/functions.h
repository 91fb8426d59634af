/* Functions as numpy computes them on this machine: libm's may differ in the last bit. */
#ifndef FUNCTIONS_H
#define FUNCTIONS_H

#include <stdint.h>

/* Take them from numpy. Return -1 with a Python exception if it lacks one. */
int load_functions(void);

void sines(const double *angles, double *out, intptr_t count);
void cosines(const double *angles, double *out, intptr_t count);
double arctangent(double y, double x);
double hypotenuse(double x, double y);

#endif
