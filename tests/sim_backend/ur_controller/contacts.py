"""Facts about contacts that only the simulation knows."""

import mujoco
import numpy as np

from sim_backend.ur_controller.plant import Plant


def pressing(plant: Plant) -> float:
    """Sum of the true forces with which contacts push the peg up, N."""
    model, data = plant.world.model(), plant.world.data()
    mujoco.mj_forward(model, data)
    total, wrench = 0.0, np.zeros(6)
    for index in range(data.ncon):
        mujoco.mj_contactForce(model, data, index, wrench)
        contact = data.contact[index]
        force = contact.frame.reshape(3, 3).T @ wrench[:3]  # on the second of the two
        total += force[2] if model.geom(contact.geom2).name == "peg" else -force[2]
    return total
