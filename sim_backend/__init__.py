"""The simulator: a UR3e with a gripper, a peg and a hole in MuJoCo (`world`), served over Zenoh (`zenoh_cell`) or as an
emulated e-Series controller (`ur_controller`).
"""
