#include "functions.h"

#include "loops.h"

static Loop sine, cosine, arctangent2, hypotenuse2;

void sines(const double *angles, double *out, intptr_t count) { loop_of_one(&sine, angles, out, count); }
void cosines(const double *angles, double *out, intptr_t count) { loop_of_one(&cosine, angles, out, count); }
double arctangent(double y, double x) { return loop_of_two(&arctangent2, y, x); }
double hypotenuse(double x, double y) { return loop_of_two(&hypotenuse2, x, y); }

int load_functions(void)
{
    import_umath1(-1);
    return loop_take("numpy", "sin", &sine) < 0 || loop_take("numpy", "cos", &cosine) < 0 ||
                   loop_take("numpy", "arctan2", &arctangent2) < 0 || loop_take("numpy", "hypot", &hypotenuse2) < 0
               ? -1
               : 0;
}
