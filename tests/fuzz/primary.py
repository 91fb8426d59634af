"""Fuzzes the primary interface: any stream and any content are read, or refused with its own error."""

import contextlib

import atheris
from fuzzing import fuzz

with atheris.instrument_imports(include=["wire.primary"]):
    from wire.primary import messages, packages, state
    from wire.primary.errors import PrimaryError

KINDS = (packages.PackageType.ROBOT_STATE, packages.PackageType.ROBOT_MESSAGE)


def read(stream: bytes, size: int) -> list[tuple[int, bytes]]:
    reader = packages.PackageReader()
    found: list[tuple[int, bytes]] = []
    with contextlib.suppress(PrimaryError):
        for start in range(0, len(stream), size):
            found.extend(reader.feed(stream[start : start + size]))
    return found


def check_content(kind: int, content: bytes) -> None:
    with contextlib.suppress(PrimaryError):
        if kind == packages.PackageType.ROBOT_MESSAGE:
            received = messages.decode_message(content)
            if received.message is not None:
                again = messages.encode_message(received.message, received.timestamp_us, received.source)
                messages.decode_message(again)
        elif kind == packages.PackageType.ROBOT_STATE:
            parts = state.decode_state(content)
            assert repr(state.decode_state(state.encode_state(parts))) == repr(parts)


def check(data: bytes) -> None:
    provider = atheris.FuzzedDataProvider(data)
    if provider.ConsumeBool():
        size = provider.ConsumeIntInRange(1, 200)
        stream = provider.ConsumeBytes(4096)
        whole = read(stream, 4096)
        assert read(stream, size) == whole
        for kind, content in whole:
            check_content(kind, content)
    else:
        kind = KINDS[provider.ConsumeBool()]
        check_content(kind, provider.ConsumeBytes(4096))


if __name__ == "__main__":
    fuzz(
        check,
        [
            packages.frame(20, messages.encode_message(messages.Text("hello"))),
            packages.frame(16, state.encode_state([state.RobotMode(0, *[True] * 7, 7), state.ToolMode(*[0] * 3)])),
            packages.frame(20, messages.encode_message(messages.Key("PROGRAM_XXX_STARTED", "main"))),
        ],
    )
