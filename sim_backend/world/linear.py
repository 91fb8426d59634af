"""Sums of products in a stated order, which numpy's `einsum` and BLAS leave to the machine."""

import numpy as np

from wire.arrays import FloatArray

_NEXT, _AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])


def product(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """Return the products (n, m) of matrices (n, m, m) and vectors (n, m), m > 1.

    The even columns are added up first to last, then the odd ones, and then both.
    """
    terms = matrix * vector[:, None, :]
    even, odd = terms[..., 0], terms[..., 1]
    for column in range(2, terms.shape[-1], 2):
        even = even + terms[..., column]
    for column in range(3, terms.shape[-1], 2):
        odd = odd + terms[..., column]
    return even + odd


def moment(point: FloatArray, force: FloatArray) -> FloatArray:
    """Return the moments (n, 3) about the origin of forces (n, 3) that act at one point (3,)."""
    return point[_NEXT] * force.take(_AFTER, 1) - point[_AFTER] * force.take(_NEXT, 1)
