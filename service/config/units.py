"""The unit in which a number out of range was probably written."""

import math

_OTHERS = {
    "m_s": ("m/s", {"mm/s": 1e-3}),
    "rad_s": ("rad/s", {"degrees/s": math.pi / 180.0}),
    "m": ("m", {"millimetres": 1e-3}),
    "rad": ("rad", {"degrees": math.pi / 180.0}),
    "kg": ("kg", {"grams": 1e-3}),
    "s": ("s", {"milliseconds": 1e-3}),
}
"""By the end of a field's name: its unit, and the units that are taken for it, with their factors."""
_TURNS = {"tcp_m": 3}
"""Fields whose components from this one on are angles."""


def likely(location: tuple[int | str, ...], value: object, bound: object) -> str | None:
    """Return a question about the unit of a number, where it would be within its bound in another one.

    Args:
        location: names and indices that lead to the number.
        value: the number as it was given.
        bound: the bound that it violates.
    """
    names = [part for part in location if isinstance(part, str)]
    if not names or not isinstance(value, int | float | str) or not isinstance(bound, int | float):
        return None
    try:
        given = float(value)
    except ValueError:
        return None
    name, index = names[-1], location[-1]
    turns = isinstance(index, int) and index >= _TURNS.get(name, math.inf)
    ending = "rad" if turns else next((end for end in _OTHERS if name.endswith(f"_{end}")), None)
    if ending is None:
        return None
    unit, others = _OTHERS[ending]
    for other, factor in others.items():
        if abs(given * factor) <= abs(bound) < abs(given):
            return f"{given * factor:.4g} {unit}? {given:g} looks like {other}"
    return None
