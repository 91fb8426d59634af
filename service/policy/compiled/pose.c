#include "pose.h"

#include <float.h>

#include "functions.h"
#include "numbers.h"

/* `np.sinc` */
static double sinc(double number)
{
    const double angle = PI * number, divisor = angle == 0.0 ? DBL_EPSILON : angle;
    double sine;
    sines(&divisor, &sine, 1);
    return sine / divisor;
}

void yaw_and_tilt(const double rotvec[3], double *yaw, double tilt[2])
{
    const double x = rotvec[0], y = rotvec[1], z = rotvec[2], angle = length3(rotvec);
    /* Rodrigues: R = I + s [v]x + c (v vT - |v|² I), s = sin(a)/a, c = (1 - cos a)/a², both finite at a = 0 */
    const double s = sinc(angle / PI), half = sinc(angle / (2 * PI)), c = 0.5 * (half * half);
    *yaw = arctangent(s * z + c * x * y, 1 - c * (y * y + z * z));
    const double tool_x = s * y + c * x * z, tool_y = -s * x + c * y * z, tool_z = 1 - c * (x * x + y * y);
    const double sine = hypotenuse(tool_x, tool_y), tilt_angle = arctangent(sine, -tool_z);
    const double ratio = sine > 1e-12 ? tilt_angle / maximum(sine, 1e-12) : 1.0;
    tilt[0] = tool_y * ratio;
    tilt[1] = -tool_x * ratio;
}

void rotvec_from_yaw(double yaw, double rotvec[3])
{
    const double half = yaw / 2;
    double cosine, sine;
    cosines(&half, &cosine, 1);
    sines(&half, &sine, 1);
    rotvec[0] = PI * cosine;
    rotvec[1] = PI * sine;
    rotvec[2] = 0.0;
}
