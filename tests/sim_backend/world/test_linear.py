import numpy as np
import pytest

from sim_backend.world.linear import moment, product


@pytest.mark.parametrize("size", [3, 6])
def test_a_product_adds_the_even_columns_then_the_odd_ones(size: int) -> None:
    rng = np.random.default_rng(0)
    matrix, vector = rng.normal(size=(50, size, size)), rng.normal(size=(50, size))
    found = product(matrix, vector)
    assert found == pytest.approx((matrix @ vector[:, :, None])[:, :, 0], abs=1e-12)
    for k, row in enumerate(matrix):
        for i in range(size):
            terms = [float(a * b) for a, b in zip(row[i], vector[k], strict=True)]
            even = odd = 0.0
            for term in terms[::2]:
                even += term
            for term in terms[1::2]:
                odd += term
            assert found[k, i] == even + odd


def test_a_moment_is_the_point_times_the_force() -> None:
    point = np.array([0.1, -0.2, 0.3])
    force = np.random.default_rng(1).normal(size=(20, 3))
    assert moment(point, force) == pytest.approx(np.cross(point, force))
