"""Surroundings of the emulated robot over Zenoh: the episode, the truth, the camera, and an operator's panel.

The arm itself speaks only UR's protocols. `docs/reference/wire.md` describes keys and records.
"""

import json
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict

import zenoh

from sim_backend.holding import SIGNATURE, SIGNED, Holding
from sim_backend.requests import RequestError, asked, query_keys, read_object, read_parameters, read_task
from sim_backend.ur_controller.controller import Controller
from sim_backend.ur_controller.events import Refused
from sim_backend.ur_controller.server import ControllerServer
from sim_backend.world.world import ESTIMATE_TICKS
from wire import keys, records

_QUERIES = {
    "reset": keys.RESET, "claim": keys.CLAIM, "release": keys.RELEASE,
    "truth": keys.TRUTH, "info": keys.INFO, "panel": keys.PANEL,
}  # fmt: skip
_READINGS = ("truth", "info")
_QUERY_CAPACITY = 64


def _to_local(controller: Controller) -> None:
    controller.remote_control = False


def _to_remote(controller: Controller) -> None:
    controller.remote_control = True


PRESSES: Mapping[str, Callable[[Controller], None]] = {
    "emergency_stop": Controller.press_emergency_stop,
    "release_emergency_stop": Controller.release_emergency_stop,
    "open_safeguard": Controller.open_safeguard,
    "close_safeguard": Controller.close_safeguard,
    "local": _to_local,
    "remote": _to_remote,
    "power_on": Controller.power_on,
    "power_off": Controller.power_off,
    "brake_release": Controller.brake_release,
    "unlock_protective_stop": Controller.unlock_protective_stop,
    "close_safety_popup": Controller.close_safety_popup,
    "restart_safety": Controller.restart_safety,
    "play": Controller.play,
    "pause": Controller.pause,
    "stop": Controller.stop_program,
}
"""Controls that a person can press at the robot: emergency stop, safeguard, key switch and PolyScope's buttons."""


def press(controller: Controller, payload: bytes) -> bytes:
    """Press the control that a request names.

    Args:
        controller: controller of the robot.
        payload: JSON object `{"press": name}`, with a name of `PRESSES`.

    Returns:
        JSON of the controller's state afterwards.

    Raises:
        RequestError: the payload is malformed, names no control, or the controller refuses.
    """
    document = read_object(payload, "panel")
    name = document.get("press")
    if len(document) != 1 or not isinstance(name, str) or name not in PRESSES:
        raise RequestError(f'panel: {{"press": name}} takes one of {", ".join(PRESSES)}')
    try:
        PRESSES[name](controller)
    except Refused as error:
        raise RequestError(f"panel: the controller refuses: {error}") from error
    return json.dumps(_state(controller)).encode()


class Surroundings:
    """Serves the surroundings of one controller under `sim/<world>/`, in the thread of its server.

    Attributes:
        epoch: identity of this world, drawn at random.
    """

    def __init__(
        self,
        controller: Controller,
        server: ControllerServer,
        session: zenoh.Session,
        world: str,
        degraded: Sequence[str] = (),
    ) -> None:
        """Declare the keys.

        Args:
            controller: controller of the arm.
            server: server that serves it and steps these surroundings.
            session: open session; the caller closes these surroundings and then the session.
            world: name of the world in its keys.
            degraded: grants that the host refused, for `info`.

        Raises:
            ValueError: a key cannot contain `world`.
        """
        self.epoch = secrets.randbits(63)
        self._controller = controller
        self._server = server
        self._holding = Holding()
        self._degraded = list(degraded)
        self._episode = 0
        self._ticks = 0
        self._keys = query_keys(world, _QUERIES)
        self._queries = session.declare_queryable(f"sim/{world}/*", zenoh.handlers.FifoChannel(_QUERY_CAPACITY))
        self._camera = session.declare_publisher(
            keys.CAMERA.format(world=world),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )

    def step(self) -> bool:
        """After a tick, publish a due camera frame and answer one query; return True if the world was laid out."""
        if self._ticks % ESTIMATE_TICKS == 0:
            self._camera.put(self.frame())
        self._ticks += 1
        query = self._queries.try_recv()
        return query is not None and self._answer(query)

    def frame(self) -> bytes:
        """Return the camera's present frame, one `records.CAMERA` record."""
        record = records.new(records.CAMERA, records.Kind.CAMERA)
        row = record[0]
        row["epoch"], row["episode"], row["seq"] = self.epoch, self._episode, self._server.counters.ticks
        row["time_s"] = self._controller.time_s
        row["position"] = self._controller.plant.estimate
        return record.tobytes()

    def close(self) -> None:
        """Stop answering; a Zenoh thread that waits at a full channel would delay the end of the session."""
        self._queries.undeclare()

    def _answer(self, query: zenoh.Query) -> bool:
        with query:
            try:
                name = asked(query, self._keys, _READINGS)
                reply = self._carry_out(
                    name, str(query.parameters), query.payload.to_bytes() if query.payload is not None else b""
                )
            except RequestError as error:
                query.reply_err(str(error), encoding=zenoh.Encoding.TEXT_PLAIN)
                return False
            query.reply(self._keys[name], reply, express=True)
            return name == "reset"

    def _carry_out(self, name: str, parameters: str, payload: bytes) -> bytes:
        if name == "reset":
            return self._lay_out(parameters, payload)
        if name == "claim":
            return self._holding.claim(parameters, payload)
        if name == "release":
            self._holding.release(parameters)
            return b""
        if name == "panel":
            return press(self._controller, payload)
        if name == "truth":
            return json.dumps(self._controller.plant.truth()).encode()
        return self._info()

    def _lay_out(self, parameters: str, payload: bytes) -> bytes:
        """Begin an episode with the arm at the start pose and reply with its first camera frame; programs continue."""
        task = read_task(payload)
        self._holding.check(read_parameters(parameters, SIGNATURE, *SIGNED), "reset")
        try:
            self._controller.plant.lay_out(task)
        except ValueError as error:
            raise RequestError(f"reset: {error}") from error
        self._episode += 1
        self._ticks = 1  # the reply is the frame of tick 0
        return self.frame()

    def _info(self) -> bytes:
        document = {
            "version": records.VERSION,
            "mode": "ur-controller",
            "epoch": self.epoch,
            "tick_s": records.TICK_S,
            "part": self._controller.plant.part,
            "controller": ".".join(map(str, self._controller.versions)),
            "ports": asdict(self._server.ports),
            "state": _state(self._controller),
            "degraded": self._degraded,
            "holder": self._holding.described(),
            "counters": asdict(self._server.counters),
        }
        return json.dumps(document).encode()


def _state(controller: Controller) -> dict[str, str | bool]:
    return {
        "robot_mode": controller.robot_mode.name,
        "safety_mode": controller.safety_mode.name,
        "runtime_state": controller.runtime_state.name,
        "remote_control": controller.remote_control,
    }
