"""The environment: a batch of insertions in the simulated world, and its Gymnasium interface."""
