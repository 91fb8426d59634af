"""The two builtins that belong to the language; they only wait."""

import math
from collections.abc import Generator
from typing import Final

from .errors import ScriptRuntimeError
from .values import Value, number

STEP_S: Final = 0.002
"""Length of a tick, s; UR's script manual, "Thread scheduling": each thread has 0.002 s to use in each frame."""


def sync() -> Generator[None]:
    """Use up the rest of this tick."""
    yield


def sleep(t: Value) -> Generator[None]:
    """Wait for `t` seconds, in whole ticks."""
    seconds = number(t, "The time to sleep")
    if not seconds < math.inf:
        raise ScriptRuntimeError(f"The time to sleep must be finite, not {seconds}")
    for _ in range(math.ceil(round(seconds / STEP_S, 6))):
        yield
