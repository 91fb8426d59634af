"""A Universal Robots arm of the e-Series: RTDE, dashboard, script upload and gripper, and the driver made of them."""
