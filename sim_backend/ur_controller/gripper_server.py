"""A Robotiq 2F-85 and the server of its URCap on the controller, TCP 63352, which takes lines of SET and GET.

Variables and their meaning are those of the gripper's manual. A position request `POS` counts from 0, open, to 255,
closed; the fingers end at 3 and 230, 85 mm and 0 mm apart. The world's peg is fastened to the flange whatever the
fingers do: they move in time and report obstacles, but exert no force on the world.
"""

from sim_backend.ur_controller.listener import Connection
from wire.records import TICK_S

STROKE_MM = 85.0
POS_OPEN, POS_CLOSED = 3, 230
"""Counts at the mechanical ends."""
SPEED_MM_S = (20.0, 150.0)
FORCE_N = (20.0, 235.0)
"""Forces at SPE or FOR 0 and 255, N."""
PEG_WIDTH_MM = 28.0

RESET, ACTIVATING, ACTIVE = 0, 1, 3
"""Values of STA, the state of the activation."""
MOVING, MET_OPENING, MET_CLOSING, ARRIVED = 0, 1, 2, 3
"""Values of OBJ, the end of the last motion."""
NO_FAULT, ACTIVATION_RUNS, NOT_ACTIVATED, RELEASING, RELEASED = 0, 5, 7, 11, 15
"""Values of FLT, the fault."""

_RELEASE_SPEED_MM_S = SPEED_MM_S[0]
_COUNT_MM = STROKE_MM / (POS_CLOSED - POS_OPEN)
_LINE_BYTES = 1024
_DIGITS = 9
"""Digits of the longest number that is read."""
_SETTABLE = ("ACT", "GTO", "ATR", "ARD", "FOR", "SPE", "POS", "MOD", "SID")
_BITS = ("ACT", "GTO", "ATR", "ARD")


class Gripper:
    """Fingers that move at the requested speed, stop at an object, and hold it.

    Args:
        object_mm: width of the object between the fingers; None without one.
        is_active: True if activated and closed on that object; False for the state after switching on.

    Attributes:
        opening_mm: distance between the fingertips.
        object_mm: width of the object; may be changed. A gripper that loses its object continues to close.
    """

    def __init__(self, object_mm: float | None = PEG_WIDTH_MM, *, is_active: bool = True) -> None:
        self.object_mm = object_mm
        self.opening_mm = STROKE_MM
        self._set = dict.fromkeys(_SETTABLE, 0) | {"SPE": 255, "SID": 9}
        self._status = RESET
        self._object = ARRIVED
        self._fault = NO_FAULT
        self._way: list[float] = []
        if is_active:
            self.opening_mm = object_mm or 0.0
            self._status = ACTIVE
            self._set |= {"ACT": 1, "GTO": 1, "POS": 255}
            self._object = ARRIVED if object_mm is None else MET_CLOSING

    @property
    def force_n(self) -> float:
        """Force on the held object, N; 0 without one."""
        low, high = FORCE_N
        return low + (high - low) * self._set["FOR"] / 255 if self._object == MET_CLOSING else 0.0

    def get(self, name: str) -> int | None:
        """Return the value of a variable; None for an unknown name."""
        readings = {"STA": self._status, "OBJ": self._object, "FLT": self._fault, "PRE": self._set["POS"]}
        if name == "POS":
            return round(POS_CLOSED - self.opening_mm / _COUNT_MM)
        return readings.get(name, self._set.get(name))

    def set(self, name: str, value: int) -> bool:
        """Write a variable; return False, and change nothing, for a read-only variable or an invalid value."""
        if name not in self._set or not 0 <= value <= (1 if name in _BITS else 255):
            return False
        before, self._set[name] = self._set[name], value
        if name == "ACT" and value != before:
            self._reset()
            if value:
                self._status = ACTIVATING
                self._way = [0.0, STROKE_MM]
        elif name == "ATR" and value and self._status == ACTIVE:
            self._fault = RELEASING
        elif name in ("POS", "GTO") and self._set["GTO"] and self._fault not in (RELEASING, RELEASED):
            self._start()
        return True

    def tick(self) -> None:
        """Advance by 2 ms."""
        if self._fault == RELEASING:
            if self._move(STROKE_MM if self._set["ARD"] else 0.0, _RELEASE_SPEED_MM_S):
                self._fault = RELEASED
        elif self._status == ACTIVATING:
            if self._move(self._way[0], self._speed):
                del self._way[0]
                if not self._way:
                    self._status, self._fault = ACTIVE, NO_FAULT
                    self._object = ARRIVED
        elif self._status == ACTIVE and self._set["GTO"] and self._fault == NO_FAULT:
            self._move(_COUNT_MM * (POS_CLOSED - self._set["POS"]), self._speed)

    @property
    def _speed(self) -> float:
        low, high = SPEED_MM_S
        return low + (high - low) * self._set["SPE"] / 255

    def _start(self) -> None:
        """Begin a requested motion."""
        if self._status == ACTIVE:
            self._object = MOVING
        else:
            self._fault = ACTIVATION_RUNS if self._status == ACTIVATING else NOT_ACTIVATED

    def _move(self, opening_mm: float, speed_mm_s: float) -> bool:
        """Continue towards an opening; return True once the fingers have come to rest."""
        wanted = min(max(opening_mm, 0.0), STROKE_MM)
        step = speed_mm_s * TICK_S
        reached = min(max(wanted, self.opening_mm - step), self.opening_mm + step)
        if self.object_mm is not None and reached < self.object_mm <= self.opening_mm:
            self.opening_mm, self._object = self.object_mm, MET_CLOSING
            return True
        self.opening_mm = reached
        self._object = ARRIVED if reached == wanted else MOVING
        return reached == wanted

    def _reset(self) -> None:
        self._status, self._object, self._fault = RESET, ARRIVED, NO_FAULT
        self._way = []
        self._set |= {"GTO": 0, "ATR": 0}


class GripperService:
    """Answers SET with `ack`, without an end of line, GET with name and value, and anything else with `?`."""

    def __init__(self, gripper: Gripper) -> None:
        self._gripper = gripper
        self._lines: dict[Connection, bytes] = {}

    def on_connect(self, connection: Connection) -> None:
        """Wait for a request."""
        self._lines[connection] = b""

    def on_data(self, connection: Connection, data: bytes) -> None:
        """Answer every complete line, with one packet for all."""
        *lines, rest = (self._lines[connection] + data).split(b"\n")
        self._lines[connection] = rest
        if replies := b"".join(self._answer(line.decode("ascii", "replace").split()) for line in lines):
            connection.send(replies)
        if len(rest) > _LINE_BYTES:
            connection.close()

    def on_close(self, connection: Connection) -> None:
        """Discard the state of the peer."""
        del self._lines[connection]

    def publish(self) -> None:
        """Advance the fingers with the arm's time."""
        self._gripper.tick()

    def _answer(self, words: list[str]) -> bytes:
        match [word.upper() for word in words]:
            case ["SET", *pairs] if pairs and len(pairs) % 2 == 0:
                done = [self._set(name, value) for name, value in zip(pairs[::2], pairs[1::2], strict=True)]
                return b"ack" if all(done) else b"?\n"
            case ["GET", name] if (value := self._gripper.get(name)) is not None:
                return f"{name} {value}\n".encode()
            case []:
                return b""
            case _:
                return b"?\n"

    def _set(self, name: str, value: str) -> bool:
        return value.isdecimal() and len(value) <= _DIGITS and self._gripper.set(name, int(value))
