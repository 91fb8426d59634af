#include "functions.h"

#include "loops.h"

static Loop sine, cosine, arctangent2, inverse;

void sines(const double *angles, double *out, intptr_t count) { loop_of_one(&sine, angles, out, count); }
void cosines(const double *angles, double *out, intptr_t count) { loop_of_one(&cosine, angles, out, count); }
double arctangent(double y, double x) { return loop_of_two(&arctangent2, y, x); }

void inverse6(const double *matrix, double *out)
{
    enum { ROW = 6 * sizeof(double), ALL = 6 * ROW };
    char *arguments[] = {(char *)matrix, (char *)out};
    const npy_intp dimensions[] = {1, 6}, strides[] = {ALL, ALL, ROW, sizeof(double), ROW, sizeof(double)};
    inverse.loop(arguments, dimensions, strides, inverse.data);
}

int functions_invert(void) { return inverse.loop != NULL; }

int functions_take(void)
{
    import_umath1(-1);
    if (loop_take("numpy", "sin", &sine) < 0 || loop_take("numpy", "cos", &cosine) < 0 ||
        loop_take("numpy", "arctan2", &arctangent2) < 0)
        return -1;
    if (loop_take("numpy.linalg._umath_linalg", "inv", &inverse) < 0)
        PyErr_Clear(); /* a private place; only `advance` needs it */
    return 0;
}
