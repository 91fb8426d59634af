"""A simulated cell: a UR3e with a gripper, a peg and a hole in MuJoCo, served over Zenoh."""
