"""The force/torque sensor is zeroed when a program starts and when the payload is set."""

import numpy as np
import pytest


def mean_force(bench, name: str, ticks: int) -> np.ndarray:
    """The mean force (3,) of an RTDE output over the next ticks."""
    forces = []
    for _ in range(ticks):
        bench.run(1)
        forces.append(bench.get(name)[:3])
    return np.mean(forces, axis=0)


def test_a_controller_zeroes_its_sensor_when_a_program_starts_in_contact_too(bench):
    bench.run(200)
    bench.plant.place((0.30, -0.35, -0.001))
    bench.run(500)
    pressed = np.linalg.norm(mean_force(bench, "actual_TCP_force", 200))
    assert pressed > 8.0
    bench.program("sync()")
    assert np.linalg.norm(mean_force(bench, "actual_TCP_force", 200)) < 1.0
    raw = mean_force(bench, "ft_raw_wrench", 200)
    assert np.linalg.norm(np.abs(raw) - [0, 0, 9.1]) > 8.0, "the raw reading keeps it"


@pytest.mark.parametrize(
    "call",
    [
        "set_payload(0.93, [0, 0, 0.0585])",
        "set_payload_mass(0.93)",
        "set_payload_cog([0, 0, 0.0585])",
        "set_target_payload(0.93, [0, 0, 0.0585])",
    ],
)
def test_a_controller_zeroes_its_sensor_when_the_payload_is_set(bench, call):
    bench.program(f"sleep(2)\n{call}\nsleep(2)")
    bench.run(200)
    bench.plant.place((0.30, -0.35, -0.001))
    bench.run(700)
    assert np.linalg.norm(mean_force(bench, "actual_TCP_force", 5)) > 5.0
    bench.run(200)
    assert np.linalg.norm(mean_force(bench, "actual_TCP_force", 100)) < 2.0
