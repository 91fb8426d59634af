"""The simulated cell served over Zenoh."""
