#include "joint_sense.h"

#include "linear.h"

/* The sum of products of three rows (6), one after another. */
static double sum3(const double *a, const double *b, const double *c)
{
    double sum = a[0] * (b[0] * c[0]);
    for (int k = 1; k < 6; k++)
        sum += a[k] * (b[k] * c[k]);
    return sum;
}

/* `joint_sense._solve` of a symmetric matrix (3, 3); a singular one leaves `out` as it is. */
static void solve(const double gram[3][3], const double moved[3], double out[3])
{
    double a = gram[0][0], b = gram[0][1], c = gram[0][2], d = gram[1][1], e = gram[1][2], f = gram[2][2];
    double aa = d * f - e * e, bb = c * e - b * f, cc = b * e - c * d;
    double dd = a * f - c * c, ee = b * c - a * e, ff = a * d - b * b;
    double determinant = a * aa + b * bb + c * cc;
    if (determinant == 0.0)
        return;
    out[0] = (aa * moved[0] + bb * moved[1] + cc * moved[2]) / determinant;
    out[1] = (bb * moved[0] + dd * moved[1] + ee * moved[2]) / determinant;
    out[2] = (cc * moved[0] + ee * moved[1] + ff * moved[2]) / determinant;
}

void drives_read(const Drives *drives, const DrivesConstants *constants, const Effort *effort, intptr_t n)
{
    const Lengths lengths = {
        constants->d1, constants->a2, constants->a3, constants->d4, constants->d5, constants->d6,
    };
    double to_com[3];
    for (int k = 0; k < 3; k++)
        to_com[k] = constants->com[k] - constants->point[k];
    for (intptr_t cell = 0; cell < n; cell++) {
        const double *speeds = numbers(effort->speeds, cell), *servo = numbers(effort->servo, cell);
        const double *constraint = numbers(effort->constraint, cell), *passive = numbers(effort->passive, cell);
        const double *bias = numbers(effort->bias, cell), *noise = numbers(effort->noise, cell);
        double *stick = numbers(drives->stick, cell);
        double flange[3], rotation[9], point[3], jacobian[36], lever[3], felt[6], gram[3][3], moved[3];
        Chain chain = chain_of(&lengths, numbers(effort->joints, cell));
        flange_of(&lengths, &chain, flange, rotation);
        point_of(flange, rotation, constants->point, point);
        jacobian_of(&lengths, &chain, point, jacobian);
        product(rotation, to_com, lever, 3);
        for (int k = 0; k < 6; k++) {
            stick[k] = within(stick[k] + speeds[k] * constants->turns_per_rad_s, 1.0);
            double carried =
                constants->weight * (jacobian[12 + k] + lever[1] * jacobian[18 + k] - lever[0] * jacobian[24 + k]);
            double inertial = servo[k] + (constraint[k] + passive[k] - bias[k]);
            felt[k] = carried - servo[k] + constants->modelled_share * inertial;
            felt[k] += constants->friction[k] * stick[k] + constants->noise_nm[k] * noise[k];
        }
        for (int row = 0; row < 3; row++) {
            for (int column = row; column < 3; column++)
                gram[row][column] = sum3(jacobian + 6 * row, jacobian + 6 * column, constants->trust);
            moved[row] = sum3(jacobian + 6 * row, constants->trust, felt);
        }
        solve(gram, moved, numbers(drives->force, cell));
    }
}
