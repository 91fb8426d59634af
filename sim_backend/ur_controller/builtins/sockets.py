"""Script builtins that talk to other hosts.

Semantics are those of UR's script manual.
"""

import re
from collections.abc import Callable, Generator
from typing import Any

from sim_backend.ur_controller.script import Builtin, ScriptRuntimeError
from sim_backend.ur_controller.script.values import Value, integer, is_number, number, text
from sim_backend.ur_controller.sockets import Sockets
from wire.records import TICK_S

MOST_NUMBERS = 30
"""Largest number of values in one read, as in the manual."""

_DEFAULT_NAME = "socket_0"
_NUMBERS = re.compile(rb"\(([^()]*)\)")


def socket_builtins(sockets: Sockets) -> dict[str, Builtin]:
    """Return the builtins for `sockets`."""

    def wait_for(
        name: Value, timeout: Value, whole: Callable[[bytearray], int | None]
    ) -> Generator[None, None, bytes | None]:
        """Wait until `whole` returns the size of a message in the buffer, and take it; None after the time-out."""
        connection = sockets.get(text(name, "socket_name"))
        ticks = number(timeout, "timeout") / TICK_S
        waited = 0
        while connection is not None:
            connection.receive()
            count = whole(connection.buffer)
            if count is not None:
                return connection.take(count)
            if not connection.is_open or 0.0 < ticks <= waited:
                return None
            waited += 1
            yield
        return None

    def send(name: Value, data: bytes) -> bool:
        connection = sockets.get(text(name, "socket_name"))
        return connection is not None and connection.send(data)

    def count_of(value: Value) -> int:
        count = integer(value, "number")
        if not 0 < count <= MOST_NUMBERS:
            raise ScriptRuntimeError(f"number must lie in 1 … {MOST_NUMBERS}, not {count}")
        return count

    def socket_open(address: Value, port: Value, socket_name: Value = _DEFAULT_NAME) -> Generator[None, None, bool]:
        return (
            yield from sockets.open(text(address, "address"), integer(port, "port"), text(socket_name, "socket_name"))
        )

    def socket_close(socket_name: Value = _DEFAULT_NAME) -> None:
        sockets.close(text(socket_name, "socket_name"))

    def socket_send_int(value: Value, socket_name: Value = _DEFAULT_NAME) -> bool:
        return send(socket_name, integer(value, "value").to_bytes(4, "big", signed=True))

    def socket_send_byte(value: Value, socket_name: Value = _DEFAULT_NAME) -> bool:
        return send(socket_name, bytes((integer(value, "value") & 0xFF,)))

    def socket_send_string(str: Value, socket_name: Value = _DEFAULT_NAME) -> bool:
        return send(socket_name, _bytes(str))

    def socket_send_line(str: Value, socket_name: Value = _DEFAULT_NAME) -> bool:
        return send(socket_name, _bytes(str) + b"\n")

    def socket_set_var(name: Value, value: Value, socket_name: Value = _DEFAULT_NAME) -> None:
        send(socket_name, f"SET {text(name, 'name')} {integer(value, 'value')}\n".encode())

    def socket_get_var(
        name: Value, socket_name: Value = _DEFAULT_NAME, timeout: Value = 2
    ) -> Generator[None, None, float]:
        send(socket_name, f"GET {text(name, 'name')}\n".encode())
        line = yield from wait_for(socket_name, timeout, _line)
        try:
            return float((line or b"").split()[-1])
        except (IndexError, ValueError):
            return float("nan")

    def socket_read_binary_integer(
        number: Value, socket_name: Value = _DEFAULT_NAME, timeout: Value = 2
    ) -> Generator[None, None, list[int]]:
        count = count_of(number)
        data = yield from wait_for(socket_name, timeout, _at_least(4 * count))
        return _counted(
            [int.from_bytes(data[i : i + 4], "big", signed=True) for i in range(0, 4 * count, 4)] if data else [], count
        )

    def socket_read_byte_list(
        number: Value, socket_name: Value = _DEFAULT_NAME, timeout: Value = 2
    ) -> Generator[None, None, list[int]]:
        count = count_of(number)
        data = yield from wait_for(socket_name, timeout, _at_least(count))
        return _counted(list(data or b""), count)

    def socket_read_ascii_float(
        number: Value, socket_name: Value = _DEFAULT_NAME, timeout: Value = 2
    ) -> Generator[None, None, list[float]]:
        count = count_of(number)
        data = yield from wait_for(socket_name, timeout, _bracketed)
        found = _NUMBERS.search(data or b"")
        try:
            numbers = [float(item) for item in found[1].split(b",")] if found else []
        except ValueError:
            numbers = []
        return _counted(numbers if len(numbers) == count else [], count)

    def socket_read_string(
        socket_name: Value = _DEFAULT_NAME,
        prefix: Value = "",
        suffix: Value = "",
        interpret_escape: Value = False,
        timeout: Value = 2,
    ) -> Generator[None, None, str]:
        first, last = _bytes(prefix), _bytes(suffix)
        if interpret_escape:
            first, last = _escaped(first), _escaped(last)
        data = yield from wait_for(socket_name, timeout, _framed(first, last))
        return (
            _text((data or b"").partition(first)[2].removesuffix(last))
            if first
            else _text((data or b"").removesuffix(last))
        )

    def socket_read_line(socket_name: Value = _DEFAULT_NAME, timeout: Value = 2) -> Generator[None, None, str]:
        line = yield from wait_for(socket_name, timeout, _line)
        return _text((line or b"").rstrip(b"\r\n"))

    calls: tuple[Callable[..., Any], ...] = (
        socket_open,
        socket_close,
        socket_send_int,
        socket_send_byte,
        socket_send_string,
        socket_send_line,
        socket_set_var,
        socket_get_var,
        socket_read_binary_integer,
        socket_read_byte_list,
        socket_read_ascii_float,
        socket_read_string,
        socket_read_line,
    )
    return {call.__name__: Builtin.of(call) for call in calls}


def _bytes(value: Value) -> bytes:
    """Encode a string, or a number as a string."""
    return (str(value) if is_number(value) else text(value, "str")).encode()


def _text(data: bytes) -> str:
    return data.decode(errors="replace")


def _escaped(data: bytes) -> bytes:
    return data.replace(b"\\n", b"\n").replace(b"\\r", b"\r").replace(b"\\t", b"\t")


def _counted(items: list[Any], count: int) -> list[Any]:
    """Return the result of a read: the number of items and the items; on a time-out 0 and as many zeros as
    asked for.
    """
    return [len(items), *items] if items else [0, *[0] * count]


def _at_least(count: int) -> Callable[[bytearray], int | None]:
    return lambda buffer: count if len(buffer) >= count else None


def _line(buffer: bytearray) -> int | None:
    end = buffer.find(b"\n")
    return end + 1 if end >= 0 else None


def _bracketed(buffer: bytearray) -> int | None:
    end = buffer.find(b")")
    return end + 1 if end >= 0 else None


def _framed(prefix: bytes, suffix: bytes) -> Callable[[bytearray], int | None]:
    def whole(buffer: bytearray) -> int | None:
        start = buffer.find(prefix)
        if start < 0 or not buffer:
            return None
        if not suffix:
            return len(buffer) if len(buffer) > start + len(prefix) else None
        end = buffer.find(suffix, start + len(prefix))
        return end + len(suffix) if end >= 0 else None

    return whole
