"""The emulated controller as a process of its own, and a side channel to the truth that no client sees.

Run as a program it serves the controller in real time on the standard ports of one address, and answers lines of JSON
on its standard input: motion and force are judged by the world, not by what a client was told.
"""

import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from wire.arrays import FloatArray


@dataclass(frozen=True)
class Truth:
    """True state of the world at one instant; base frame, SI.

    Attributes:
        time_s: the controller's clock.
        q: (6,) joint angles.
        qd: (6,) joint speeds.
        position: (3,) of the tip of the peg's nominal axis: the scene's TCP, whatever TCP is configured.
        rotation: (3, 3) of the same.
        twist: (6,) of the same.
        contact: (3,) sum of the contact forces on the peg.
        hole: (3,) centre of the hole's mouth, on the block's top.
        hole_yaw: about the vertical, rad.
    """

    time_s: float
    q: FloatArray
    qd: FloatArray
    position: FloatArray
    rotation: FloatArray
    twist: FloatArray
    contact: FloatArray
    hole: FloatArray
    hole_yaw: float


@dataclass(frozen=True)
class Recording:
    """One row per tick.

    Attributes:
        time_s: (n,)
        q: (n, 6)
        qd: (n, 6)
        position: (n, 3) as in `Truth`.
        load: (n,) resultant force that the flange carries, weight and inertia of the tool among it, N.
    """

    time_s: FloatArray
    q: FloatArray
    qd: FloatArray
    position: FloatArray
    load: FloatArray

    @property
    def speed(self) -> FloatArray:
        """(n - 1,) of `position`, m/s."""
        return np.linalg.norm(np.diff(self.position, axis=0), axis=1) / np.diff(self.time_s)


class EmulatedRobot:
    """A running emulated controller.

    Args:
        hosts: addresses of which it takes the first whose ports are free.

    Attributes:
        host: the one that it has taken.
    """

    def __init__(self, hosts: Sequence[str]) -> None:
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__)), *hosts], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        try:
            self.host: str = self._answer()
        except AssertionError:
            self.close()
            raise

    def close(self) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        try:
            code = self._process.wait(5)
        finally:
            self._process.kill()
            self._process.stdout.close()
        assert code == 0

    def truth(self) -> Truth:
        fields = self._ask("truth")
        return Truth(**{name: np.array(v) if isinstance(v, list) else v for name, v in fields.items()})

    def is_at_rest(self) -> bool:
        """Return whether all joints come to rest within half a second."""
        return until(lambda: bool(np.abs(self.truth().qd).max() < 2e-3), 0.5)

    def get(self, path: str) -> Any:
        """Read an attribute of the controller, such as `plant.payload_kg`."""
        return self._ask("get", path)

    def set(self, path: str, value: Any) -> None:
        """Set an attribute of the controller, such as `terminals.digital_inputs`."""
        self._ask("set", path, value)

    def call(self, path: str, *arguments: Any) -> Any:
        """Call a method of the controller, such as `press_emergency_stop`."""
        return self._ask("call", path, *arguments)

    def lay_out(self, seed: int = 0) -> None:
        """A new episode: the arm rests at the start pose."""
        self._ask("lay_out", seed)

    def place_over_the_block(self, height_m: float) -> None:
        """Put the arm at rest with the peg above the block's top, beside the hole."""
        truth = self.truth()
        across = np.array([np.cos(truth.hole_yaw), np.sin(truth.hole_yaw), 0.0])
        self.call("plant.place", (truth.hole + 0.045 * across + [0.0, 0.0, height_m]).tolist())

    @contextmanager
    def recording(self) -> Generator[Callable[[], Recording]]:
        """Record every tick; what this yields returns what has been recorded so far."""
        self._ask("record")

        def rows() -> Recording:
            table = np.array(self._ask("recorded"))
            return Recording(table[:, 0], table[:, 1:7], table[:, 7:13], table[:, 13:16], table[:, 16])

        yield rows
        self._ask("forget")

    def _ask(self, *request: Any) -> Any:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        answer = self._answer()
        if isinstance(answer, dict) and "error" in answer:
            raise AssertionError(answer["error"])
        return answer

    def _answer(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, f"the emulated robot ended, exit code {self._process.wait(5)}"
        return json.loads(line)


def plus(vector: npt.ArrayLike, *change: float) -> FloatArray:
    """The sum of a vector and as many numbers."""
    return np.asarray(vector) + np.array(change)


def until(condition: Callable[[], bool], timeout_s: float = 5.0) -> bool:
    """Wait for `condition`; False if it has not come true in time."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.004)
    return True


def reupload(control: Any) -> bool:
    """Let a control client of ur_rtde send its script again; whether it runs."""
    return control.reuploadScript() and until(control.isProgramRunning)


class _Process:
    """The served side: one controller, its server, and the answers to the test's questions."""

    def __init__(self, hosts: Sequence[str]) -> None:
        from sim_backend.ur_controller.assembly import make_controller
        from sim_backend.ur_controller.listener import ListenError
        from sim_backend.ur_controller.plant import Plant
        from sim_backend.ur_controller.server import ControllerServer, Ports
        from sim_backend.world.world import World

        self._world = World(1, "tr")
        for self.host in hosts:
            self._controller = make_controller(Plant(self._world))
            try:
                self._server = ControllerServer(self._controller, self.host, Ports())
                break
            except ListenError:
                if self.host == hosts[-1]:
                    raise
        self._rows: list[list[float]] | None = None
        self._model = self._world.model()
        self._controller.events.append(self._show)

    def run(self) -> None:
        from sim_backend.metronome import Metronome
        from wire.realtime import SIMULATOR_PRIORITY, request_realtime, settle_interpreter
        from wire.records import TICK_S

        request_realtime(SIMULATOR_PRIORITY)
        settle_interpreter()
        metronome = Metronome(TICK_S)
        buffer = b""
        print(json.dumps(self.host), flush=True)
        while True:
            self._server.step()
            if self._rows is not None:
                world = self._world
                load = float(world.true_force[0])
                row = np.concatenate([world.joints[0], world.joint_speeds[0], world.position[0]])
                self._rows.append([self._controller.time_s, *row.tolist(), load])
            while select.select([0], [], [], 0)[0]:
                received = os.read(0, 65536)
                if not received:
                    self._server.close()
                    return
                buffer += received
                *lines, buffer = buffer.split(b"\n")
                for line in lines:
                    self._reply(json.loads(line))
            metronome.wait()

    @staticmethod
    def _show(event: Any) -> None:
        """Let a test that fails show what happened on the controller."""
        if type(event).__name__ != "Text":
            print(event, file=sys.stderr, flush=True)

    def _reply(self, request: list[Any]) -> None:
        kind, *arguments = request
        try:
            answer = getattr(self, f"_{kind}")(*arguments)
        except Exception as error:
            answer = {"error": f"{request}: {error!r}"}
        print(json.dumps(answer, default=_plain), flush=True)

    def _get(self, path: str) -> Any:
        return attrgetter(path)(self._controller)

    def _set(self, path: str, value: Any) -> None:
        owner, _, name = path.rpartition(".")
        setattr(attrgetter(owner)(self._controller) if owner else self._controller, name, value)

    def _call(self, path: str, *arguments: Any) -> Any:
        return attrgetter(path)(self._controller)(*arguments)

    def _lay_out(self, seed: int) -> None:
        from wire.task import Task

        self._controller.plant.lay_out(Task(seed))
        self._model = self._world.model()

    def _record(self) -> None:
        self._rows = []

    def _recorded(self) -> list[list[float]]:
        assert self._rows is not None
        return self._rows

    def _forget(self) -> None:
        self._rows = None

    def _truth(self) -> dict[str, Any]:
        world = self._world
        return {
            "time_s": self._controller.time_s,
            "q": world.joints[0],
            "qd": world.joint_speeds[0],
            "position": world.position[0],
            "rotation": world.rotation[0],
            "twist": self._twist(),
            "contact": self._contact(),
            "hole": world.hole_position[0],
            "hole_yaw": float(world.hole_yaw[0]),
        }

    def _present(self) -> Any:
        import mujoco

        data = self._world.data()
        mujoco.mj_forward(self._model, data)
        return data

    def _twist(self) -> FloatArray:
        import mujoco

        data = self._present()
        jacobian = np.zeros((6, self._model.nv))
        mujoco.mj_jacSite(self._model, data, jacobian[:3], jacobian[3:], self._model.site("tcp").id)
        return jacobian @ data.qvel

    def _contact(self) -> FloatArray:
        """(3,) what block and table push the peg with, as the physics solved it."""
        import mujoco

        model, data = self._model, self._present()
        peg = model.geom("peg").id
        total, wrench = np.zeros(3), np.zeros(6)
        for index in range(data.ncon):
            contact = data.contact[index]
            mujoco.mj_contactForce(model, data, index, wrench)
            force = contact.frame.reshape(3, 3).T @ wrench[:3]
            total += force if contact.geom2 == peg else -force
        return total


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Enum):
        return value.value
    return str(value)


if __name__ == "__main__":
    _Process(sys.argv[1:]).run()
