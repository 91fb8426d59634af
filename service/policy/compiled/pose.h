/* pose.py: orientations of a tool that points down. */
#ifndef POSE_H
#define POSE_H

/* `yaw_and_tilt` */
void yaw_and_tilt(const double rotvec[3], double *yaw, double tilt[2]);

/* `rotvec_from_yaw` */
void rotvec_from_yaw(double yaw, double rotvec[3]);

#endif
