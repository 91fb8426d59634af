"""Fuzzes the emulated controller through RTDE: no client can end it, whatever bytes it sends before or after set-up."""

import itertools
import math

import atheris
from fuzzing import fuzz

from sim_backend.ur_controller.assembly import make_controller
from sim_backend.ur_controller.outputs import Outputs
from sim_backend.ur_controller.plant import Plant
from sim_backend.world.world import World

with atheris.instrument_imports(include=["wire.rtde", "sim_backend.ur_controller.rtde_server"]):
    from sim_backend.ur_controller.rtde_server import RtdeService
    from wire.rtde.codec import FrameReader, PackageType, Recipe, frame
    from wire.rtde.fields import INPUTS, OUTPUTS
    from wire.rtde.messages import InputsRequest, OutputsRequest, TextMessage, encode_version_request

NAMES = sorted(INPUTS.keys() | OUTPUTS.keys())


class Client:
    """A connection as the service sees it."""

    def __init__(self) -> None:
        self.pending = 0
        self.closed = False
        self.answers = FrameReader()

    def send(self, data: bytes) -> None:
        for _ in self.answers.feed(data):
            pass

    def close(self) -> None:
        self.closed = True


controller = make_controller(Plant(World(1, "tr")))
service = RtdeService(controller, Outputs(controller))


def package(provider: atheris.FuzzedDataProvider, recipes: list[list[str]]) -> bytes:
    """One package, mostly well formed, of any content."""
    names = [provider.PickValueInList(NAMES) for _ in range(provider.ConsumeIntInRange(0, 8))]
    match provider.ConsumeIntInRange(0, 7):
        case 0:
            return encode_version_request(provider.ConsumeIntInRange(0, 3))
        case 1:
            return OutputsRequest(tuple(names), provider.ConsumeFloat()).encode()
        case 2:
            recipes.append(names)
            return InputsRequest(tuple(names)).encode()
        case 3:
            return frame(provider.PickValueInList(list(PackageType)))
        case 4 if recipes:
            number = provider.ConsumeIntInRange(0, len(recipes) - 1)
            types = [INPUTS[name] for name in recipes[number] if name in INPUTS]
            size = Recipe(recipes[number], types, number + 1).size if len(types) == len(recipes[number]) > 0 else 9
            return frame(
                PackageType.DATA, bytes([number + 1]) + provider.ConsumeBytes(size - 1).ljust(size - 1, b"\xff")
            )
        case 5:
            return TextMessage(provider.ConsumeUnicodeNoSurrogates(20), "", 3).encode()
        case 6:
            return frame(provider.ConsumeIntInRange(0, 255), provider.ConsumeBytes(40))
        case _:
            return provider.ConsumeBytes(20)


def check(data: bytes) -> None:
    provider = atheris.FuzzedDataProvider(data)
    client = Client()
    recipes: list[list[str]] = []
    service.on_connect(client)
    for _ in itertools.takewhile(lambda _: provider.remaining_bytes() and not client.closed, range(12)):
        service.on_data(client, package(provider, recipes))
        controller.tick()
        service.publish()
    service.on_close(client)
    assert all(math.isfinite(angle) for angle in controller.plant.q)
    assert controller.robot_mode == 7


if __name__ == "__main__":
    fuzz(check, [bytes(range(256)), b"\x02\x04" * 100, b"\x01\x01\x03\x04" * 60])
