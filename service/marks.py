"""Marks in the order of stops, as repeated starts carry them."""

from service.messages import StopMark

KEYS_HEARD = 1024
"""Idempotency keys whose first mark is remembered."""


class FirstMarks:
    """Remembers the mark of the first start under each idempotency key: a repeated start is as old as the first."""

    def __init__(self) -> None:
        self._marks: dict[str, StopMark | None] = {}

    def of(self, key: str | None, mark: StopMark | None) -> StopMark | None:
        """Return the mark of the first start under a key.

        Args:
            key: idempotency key of the start; without one, the start has its own mark.
            mark: own mark of the start; it also counts where the first one had none.
        """
        if key is None:
            return mark
        first = self._marks.setdefault(key, mark)
        if len(self._marks) > KEYS_HEARD:
            del self._marks[next(iter(self._marks))]
        return first or mark
