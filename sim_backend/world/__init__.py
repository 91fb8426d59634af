"""The world: scene, parts, arm, compliance law, sensor, kinematics and rendering, for any number of cells."""
