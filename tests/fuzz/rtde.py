"""Fuzzes the RTDE codec: any stream, payload and recipe is read or refused, and what was read can be written."""

import contextlib
import itertools

import atheris
from fuzzing import fuzz

with atheris.instrument_imports(include=["wire.rtde"]):
    from wire.rtde.codec import HEADER_SIZE, FrameReader, PackageType, Recipe, frame
    from wire.rtde.errors import FramingError, PackageError, RtdeError
    from wire.rtde.fields import FieldType
    from wire.rtde.messages import (
        ControllerVersion,
        InputsRequest,
        OutputsRequest,
        SetupReply,
        TextMessage,
        decode_accepted,
        decode_version_request,
        encode_accepted,
        encode_version_request,
    )

TYPES = list(FieldType)


def read_stream(stream: bytes, cuts: list[int], limit: int) -> tuple[list[tuple[int, bytes]], bool]:
    """Packages of a stream that comes in chunks, and whether it broke."""
    reader = FrameReader(limit)
    packages: list[tuple[int, bytes]] = []
    try:
        for start, end in itertools.pairwise([0, *cuts, len(stream)]):
            packages.extend(reader.feed(stream[start:end]))
    except FramingError:
        return packages, True
    return packages, False


def check_stream(provider: atheris.FuzzedDataProvider) -> None:
    limit = provider.ConsumeIntInRange(HEADER_SIZE, 0xFFFF)
    cuts = sorted(provider.ConsumeIntListInRange(provider.ConsumeIntInRange(0, 20), 0, 4096))
    stream = provider.ConsumeBytes(4096)
    whole, broken = read_stream(stream, [], limit)
    parts, broken_in_parts = read_stream(stream, [min(cut, len(stream)) for cut in cuts], limit)
    assert broken == broken_in_parts
    assert parts == whole[: len(parts)]
    assert broken or parts == whole
    assert stream.startswith(b"".join(frame(kind, payload) for kind, payload in whole))


def payload_of(package: bytes) -> bytes:
    ((_, payload),) = FrameReader().feed(package)
    return payload


def check_payload(payload: bytes) -> None:
    with contextlib.suppress(PackageError):
        assert payload_of(ControllerVersion.decode(payload).encode()) == payload
    with contextlib.suppress(PackageError):
        assert payload_of(encode_version_request(decode_version_request(payload))) == payload
    with contextlib.suppress(PackageError):
        accepted = decode_accepted(payload)
        assert decode_accepted(payload_of(encode_accepted(PackageType.START, accepted))) == accepted
    with contextlib.suppress(PackageError):
        inputs = InputsRequest.decode(payload)
        assert InputsRequest.decode(payload_of(inputs.encode())) == inputs
    for version in (1, 2):
        with contextlib.suppress(PackageError):
            outputs = OutputsRequest.decode(payload, version)
            assert repr(OutputsRequest.decode(payload_of(outputs.encode()), version)) == repr(outputs)
    with contextlib.suppress(RtdeError):
        reply = SetupReply.decode(payload)
        recipe = reply.recipe([str(number) for number in range(len(reply.types))])
        assert recipe.recipe_id == payload[0]
    for decode in (TextMessage.decode, TextMessage.decode_v1):
        with contextlib.suppress(PackageError):
            text = decode(payload)
            assert len(text.message) + len(text.source) < len(payload)
            assert payload_of(text.encode())[-1] == text.level


def check_recipe(provider: atheris.FuzzedDataProvider) -> None:
    chosen = provider.ConsumeIntListInRange(provider.ConsumeIntInRange(0, 40), 0, len(TYPES) - 1)
    types = [TYPES[number] for number in chosen]
    recipe_id = provider.ConsumeIntInRange(-1, 300)
    payload = provider.ConsumeBytes(4096)
    with contextlib.suppress(PackageError):
        recipe = Recipe([str(i) for i in range(len(types))], types, None if recipe_id == -1 else recipe_id)
        values = recipe.decode(payload.ljust(recipe.size, b"\0")[: recipe.size])
        again = recipe.decode(payload_of(recipe.encode(values)))
        assert repr(again) == repr(values)
        recipe.decode(payload)


def check(data: bytes) -> None:
    provider = atheris.FuzzedDataProvider(data)
    match provider.ConsumeIntInRange(0, 2):
        case 0:
            check_stream(provider)
        case 1:
            check_recipe(provider)
        case _:
            check_payload(provider.ConsumeBytes(4096))


if __name__ == "__main__":
    fuzz(
        check,
        [
            ControllerVersion(5, 21, 3, 9).encode(),
            TextMessage("message", "source", 1).encode(),
            OutputsRequest(("timestamp", "actual_q"), 500.0).encode(),
            SetupReply(("DOUBLE", "VECTOR6D", "IN_USE"), 1).encode(PackageType.SETUP_INPUTS),
            Recipe(["a", "b"], [FieldType.DOUBLE, FieldType.VECTOR6INT32], 1).encode((0.5, range(6))),
        ],
    )
