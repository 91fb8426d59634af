"""What crosses the wire between a simulated cell and its clients; needs no MuJoCo nor the rest of `sim_backend`."""
