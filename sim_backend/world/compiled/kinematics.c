#include "kinematics.h"

#include <math.h>
#include <string.h>

#include "functions.h"

Chain chain_of(const Lengths *lengths, const double q[6])
{
    double q23 = q[1] + q[2];
    double angles[7] = {q[0], q[1], q23, q23 + q[3], q[4], q[5], q[2]}, sine[7], cosine[6];
    sines(angles, sine, 7);
    cosines(angles, cosine, 6);
    Chain chain = {
        .s1 = sine[0],
        .c1 = cosine[0],
        .s3 = sine[6],
        .s5 = sine[4],
        .c5 = cosine[4],
        .s6 = sine[5],
        .c6 = cosine[5],
        .elbow_x = lengths->a2 * cosine[1],
        .elbow_z = lengths->a2 * sine[1] + lengths->d1,
        .s234 = sine[3],
        .c234 = cosine[3],
    };
    chain.wrist_x = chain.elbow_x + lengths->a3 * cosine[2];
    chain.wrist_z = chain.elbow_z + lengths->a3 * sine[2];
    return chain;
}

void flange_of(const Lengths *lengths, const Chain *chain, double position[3], double rotation[9])
{
    double s1 = chain->s1, c1 = chain->c1, s5 = chain->s5, c5 = chain->c5, s6 = chain->s6, c6 = chain->c6;
    double x4_x = c1 * chain->c234, x4_y = s1 * chain->c234, x4_z = chain->s234;
    double z4_x = c1 * chain->s234, z4_y = s1 * chain->s234, z4_z = -chain->c234;
    double x5_x = c5 * x4_x + s5 * s1, x5_y = c5 * x4_y - s5 * c1, x5_z = c5 * x4_z;
    rotation[0] = c6 * x5_x - s6 * z4_x;
    rotation[3] = c6 * x5_y - s6 * z4_y;
    rotation[6] = c6 * x5_z - s6 * z4_z;
    rotation[1] = -s6 * x5_x - c6 * z4_x;
    rotation[4] = -s6 * x5_y - c6 * z4_y;
    rotation[7] = -s6 * x5_z - c6 * z4_z;
    rotation[2] = c5 * s1 - s5 * x4_x;
    rotation[5] = -c5 * c1 - s5 * x4_y;
    rotation[8] = -s5 * x4_z;
    position[0] = c1 * chain->wrist_x + lengths->d4 * s1 + lengths->d5 * z4_x;
    position[1] = s1 * chain->wrist_x - lengths->d4 * c1 + lengths->d5 * z4_y;
    position[2] = chain->wrist_z + lengths->d5 * z4_z;
    for (int k = 0; k < 3; k++)
        position[k] += lengths->d6 * rotation[3 * k + 2];
}

void point_of(const double position[3], const double rotation[9], const double offset[3], double point[3])
{
    for (int k = 0; k < 3; k++) {
        const double *row = rotation + 3 * k;
        point[k] = position[k] + (row[0] * offset[0] + row[1] * offset[1] + row[2] * offset[2]);
    }
}

void jacobian_of(const Lengths *lengths, const Chain *chain, const double point[3], double out[36])
{
    double s1 = chain->s1, c1 = chain->c1, s5 = chain->s5, c5 = chain->c5;
    double x = point[0], y = point[1], z = point[2];
    memset(out, 0, 36 * sizeof *out);
    out[0] = -y, out[6] = x, out[30] = 1.0;
    double reach = x * c1 + y * s1;
    const double centre_x[3] = {0.0, chain->elbow_x, chain->wrist_x};
    const double centre_z[3] = {lengths->d1, chain->elbow_z, chain->wrist_z};
    for (int k = 0; k < 3; k++) {
        double *column = out + 1 + k, up = z - centre_z[k];
        column[0] = -c1 * up;
        column[6] = -s1 * up;
        column[12] = reach - centre_x[k];
        column[18] = s1;
        column[24] = -c1;
    }
    const double axes[2][3] = {
        {c1 * chain->s234, s1 * chain->s234, -chain->c234},
        {c5 * s1 - s5 * c1 * chain->c234, -c5 * c1 - s5 * s1 * chain->c234, -s5 * chain->s234},
    };
    double from_x = x - (c1 * chain->wrist_x + lengths->d4 * s1 + lengths->d5 * axes[0][0]);
    double from_y = y - (s1 * chain->wrist_x - lengths->d4 * c1 + lengths->d5 * axes[0][1]);
    double from_z = z - (chain->wrist_z + lengths->d5 * axes[0][2]);
    for (int k = 0; k < 2; k++) {
        double *column = out + 4 + k;
        const double *axis = axes[k];
        column[0] = axis[1] * from_z - axis[2] * from_y;
        column[6] = axis[2] * from_x - axis[0] * from_z;
        column[12] = axis[0] * from_y - axis[1] * from_x;
        column[18] = axis[0];
        column[24] = axis[1];
        column[30] = axis[2];
    }
}

/* The smallest of the three margins. */
double singularity_margin(const Lengths *lengths, const Chain *chain)
{
    double shoulder = fabs(chain->wrist_x + lengths->d5 * chain->s234);
    shoulder /= fabs(lengths->a2) + fabs(lengths->a3) + lengths->d5;
    return fmin(shoulder, fmin(fabs(chain->s3), fabs(chain->s5)));
}
