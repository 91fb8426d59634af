"""An emulated Universal Robots e-Series controller that drives the simulated cell's arm."""
