"""What crosses the wire between a simulated cell and its clients; imports neither MuJoCo nor the rest of `sim_backend`."""
