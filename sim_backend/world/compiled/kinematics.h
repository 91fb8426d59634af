/* Of kinematics.py what an exact solution needs. */
#ifndef KINEMATICS_H
#define KINEMATICS_H

#include <stdint.h>

typedef struct {
    double d1, a2, a3, d4, d5, d6;
} Lengths;

/* As `kinematics._Chain`, with the sine of joint 3. */
typedef struct {
    double s1, c1, s3, s5, c5, s6, c6, elbow_x, elbow_z, wrist_x, wrist_z, s234, c234;
} Chain;

Chain chain_of(const Lengths *lengths, const double joints[6]);
void flange_of(const Lengths *lengths, const Chain *chain, double position[3], double rotation[9]);
void point_of(const double position[3], const double rotation[9], const double offset[3], double point[3]);
void jacobian_of(const Lengths *lengths, const Chain *chain, const double point[3], double jacobian[36]);
double singularity_margin(const Lengths *lengths, const Chain *chain);

#endif
