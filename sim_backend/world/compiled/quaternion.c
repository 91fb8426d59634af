#include "quaternion.h"

#include <float.h>
#include <math.h>

#include "functions.h"

#define PI 3.141592653589793

static void cross(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

double length3(const double v[3]) { return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

double inner4(const double a[4], const double b[4]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]; }

void rotation_between(const double start[4], const double end[4], double rotvec[3])
{
    double crossed[3];
    cross(start + 1, end + 1, crossed);
    for (int k = 0; k < 3; k++)
        rotvec[k] = start[0] * end[k + 1] - end[0] * start[k + 1] + crossed[k];
    double scalar = inner4(start, end);
    double sine = length3(rotvec);
    double angle = 2.0 * arctangent(sine, fabs(scalar));
    double factor = copysign(angle, scalar) / fmax(sine, 1e-12);
    for (int k = 0; k < 3; k++)
        rotvec[k] *= factor;
}

void turn(double quaternion[4], const double half_step[3])
{
    double *vector = quaternion + 1, crossed[3];
    cross(half_step, vector, crossed);
    double scalar =
        quaternion[0] - (half_step[0] * vector[0] + half_step[1] * vector[1] + half_step[2] * vector[2]);
    for (int k = 0; k < 3; k++)
        vector[k] += half_step[k] * quaternion[0] + crossed[k];
    quaternion[0] = scalar;
    double norm = sqrt(inner4(quaternion, quaternion));
    for (int k = 0; k < 4; k++)
        quaternion[k] /= norm;
}

/* `from_rotvec` of a rotation vector (3). */
static void from_rotvec(const double rotvec[3], double quaternion[4])
{
    double angle = length3(rotvec), half = 0.5 * angle, sine;
    cosines(&half, quaternion, 1);
    double x = PI * (angle / (2.0 * PI));
    x = x != 0.0 ? x : DBL_EPSILON; /* as numpy's sinc */
    sines(&x, &sine, 1);
    double share = 0.5 * (sine / x);
    for (int k = 0; k < 3; k++)
        quaternion[k + 1] = rotvec[k] * share;
}

void rotvec_of(const double m[9], double rotvec[3])
{
    double xx = m[0], yy = m[4], zz = m[8];
    double a = m[7] - m[5], b = m[2] - m[6], c = m[3] - m[1];
    double d = m[1] + m[3], e = m[2] + m[6], f = m[5] + m[7];
    const double outer[4][4] = {
        {1.0 + xx + yy + zz, a, b, c},
        {a, 1.0 + xx - yy - zz, d, e},
        {b, d, 1.0 - xx + yy - zz, f},
        {c, e, f, 1.0 - xx - yy + zz},
    };
    int best = 0;
    for (int k = 1; k < 4; k++)
        if (outer[k][k] > outer[best][best])
            best = k;
    double scalar = outer[best][0], sign = scalar < 0.0 ? -1.0 : 1.0;
    for (int k = 0; k < 3; k++)
        rotvec[k] = outer[best][k + 1] * sign;
    double sine = length3(rotvec);
    double angle = 2.0 * arctangent(sine, fabs(scalar));
    double factor = sine > 0.0 ? angle / sine : 0.0;
    for (int k = 0; k < 3; k++)
        rotvec[k] *= factor;
}

void quaternion_of(const double rotation[9], double quaternion[4])
{
    double rotvec[3];
    rotvec_of(rotation, rotvec);
    from_rotvec(rotvec, quaternion);
}
