/* quaternion.py, and `rotvec_from_rotation` of wire/pose.py. */
#ifndef QUATERNION_H
#define QUATERNION_H

double length3(const double v[3]);
double inner4(const double a[4], const double b[4]);
void rotation_between(const double start[4], const double end[4], double rotvec[3]);
void turn(double quaternion[4], const double half_step[3]);
void rotvec_of(const double rotation[9], double rotvec[3]);
void quaternion_of(const double rotation[9], double quaternion[4]);

#endif
