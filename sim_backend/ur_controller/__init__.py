"""An emulated Universal Robots e-Series controller whose arm is the simulated cell's."""
