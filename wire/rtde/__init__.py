"""RTDE, the real-time data exchange of UR controllers, as bytes: fields, packages and errors; no sockets.

Both ends use it: the driver (`service/drivers/ur`) and the emulated controller (`sim_backend/ur_controller`).
"""
