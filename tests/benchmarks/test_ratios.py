"""Cost of this project beside the bare library, in the same run: ratios with generous bounds, no times."""

import importlib

import pytest

BOUNDS = {
    ("tick", "policy step to bare ONNX call"): 60.0,
    ("tick", "sample without a policy step to bare ONNX call"): 3.0,
    ("round_trip", "lockstep tick to bare query"): 25.0,
    ("rtde", "CPU per package to a plain struct loop"): 8.0,
    ("inference", "call after a rest to a hot one"): 30.0,
}
"""Two to four times what was measured on a quiet machine. A slide beyond them is a slide of the code."""
SCALE = 0.05
ATTEMPTS = 3
"""A slide of the code shows in every measurement, a busy machine in one."""


@pytest.mark.parametrize("case", sorted({case for case, _ in BOUNDS}))
def test_the_ratio_to_the_bare_library_has_not_slid(case: str) -> None:
    measure = importlib.import_module(f"benchmarks.cases.{case}").measure
    wanted = {name: bound for (of, name), bound in BOUNDS.items() if of == case}
    beyond: dict[str, float] = {}
    for _ in range(ATTEMPTS):
        values = {figure.name: figure.value for figure in measure(SCALE).figures}
        beyond = {name: values[name] for name, bound in wanted.items() if not values[name] <= bound}
        if not beyond:
            return
    assert beyond == {}
