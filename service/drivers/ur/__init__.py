"""Driver of a Universal Robots e-Series arm, built from RTDE, dashboard, script upload and gripper."""
