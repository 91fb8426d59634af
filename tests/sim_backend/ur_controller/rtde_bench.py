"""A controller with RTDE alone, for tests that let its time pass tick by tick."""

from sim_backend.ur_controller.assembly import make_controller
from sim_backend.ur_controller.listener import Listener
from sim_backend.ur_controller.outputs import Outputs
from sim_backend.ur_controller.plant import Plant
from sim_backend.ur_controller.rtde_server import RtdeService
from sim_backend.world.world import World
from tests.sim_backend.ur_controller.rtde_peer import Peer

HOST = "127.0.0.22"


class Bench:
    def __init__(self) -> None:
        self.now_s = 0.0
        self.controller = make_controller(Plant(World(1, "tr")))
        self.outputs = Outputs(self.controller)
        self.service = RtdeService(self.controller, self.outputs)
        self.loop = Listener(lambda: self.now_s)
        self.address = (HOST, self.loop.serve(self.service, HOST, 0))
        self.peers: list[Peer] = []

    def peer(self, receive_buffer: int | None = None) -> Peer:
        self.peers.append(Peer(self.address, self.loop.poll, receive_buffer))
        return self.peers[-1]

    def tick(self, ticks: int = 1) -> None:
        for _ in range(ticks):
            self.loop.poll()
            self.controller.tick()
            self.loop.publish()

    def close(self) -> None:
        for peer in self.peers:
            peer.socket.close()
        self.loop.close()
