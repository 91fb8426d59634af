"""The environment: insertions in the simulated world, any number at once, and the Gymnasium interface to them."""
