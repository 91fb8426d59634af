"""The cell itself, its recipes, its simulator, its camera, its HTTP server and its clients."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, WithJsonSchema

from service.config.fields import CommonName, Endpoint, Force, Host, Name, Port, Position, Section, Turn, count, number
from wire.endpoints import DEFAULT_ENDPOINT, DEFAULT_WORLD
from wire.impact import IMPACT_SHARE
from wire.limits import FORCE_HARD_MAXIMUM_N
from wire.modes import LockMode, TimeMode
from wire.plant import PlantErrors
from wire.task import Conditions


class CellSection(Section):
    """Identity of the cell and address of its control process.

    Attributes:
        id: name of the cell in keys, paths and URLs.
        endpoint: Zenoh endpoint that the control process listens on.
        driver: `zenoh_sim` for a simulated cell over Zenoh, `ur` for an e-Series controller, real or emulated.
        state_dir: folder of latch and ledger.
        realtime: whether control process, policies and simulator ask the host for real-time scheduling and locked
            memory; None: only for a real arm.
    """

    id: Name
    endpoint: Endpoint = "tcp/127.0.0.1:7447"
    driver: Literal["zenoh_sim", "ur"] = "zenoh_sim"
    state_dir: Path
    realtime: bool | None = None


PlantField = Annotated[PlantErrors, BeforeValidator(PlantErrors.from_json), WithJsonSchema({"type": "object"})]


class RecipeSection(Section):
    """One insertion: its part, its policy and its poses. The policy's contract has the compliance law.

    Attributes:
        part: name of peg and hole.
        clearance_m: clearance per face.
        policy: ONNX file with its contract.
        policy_sha256: hash of the file; a file with another hash is refused.
        force_ceiling_n: force ceiling for this part, where lower than that of the cell.
        start_position_m: position of the TCP from which the approach starts, base frame.
        start_yaw_rad: yaw of the peg during the approach.
        nominal_hole_m: centre of the hole's mouth, used where no camera estimates it.
        hover_m: height above the hole's mouth at which the approach ends.
        impact_n: momentary true force that the part bears; None: twice its force ceiling.
        approach_speed_m_s: speed of the scripted moves; None: 0.08 m/s, or less where the part would not bear the blow.
        max_steps: policy steps before the run fails, where fewer than the policy's own.
        success_depth_m: depth of the peg's bottom below the surface that counts as inserted.
        retract: whether the tool moves up at the end of a run; otherwise it stays where the run ended.
        conditions: distributions from which a simulated world is drawn.
        plant: errors of a simulated world's plant, by their names in `wire.plant`.
        allow_lock: modes of the safety lock that the policy may use.
    """

    part: Name
    clearance_m: Annotated[float, number(0.05e-3, 6e-3, "range of clearances that the simulated world has")]
    policy: Path
    policy_sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None = None
    force_ceiling_n: Force | None = None
    start_position_m: Position
    start_yaw_rad: Turn
    nominal_hole_m: Position
    hover_m: Annotated[float, number(0.005, 0.1, "the hole's height is uncertain; a long search")] = 0.025
    impact_n: Annotated[float, number(1.0, 2.0 * FORCE_HARD_MAXIMUM_N, "the sensor's noise; a broken part")] | None = (
        None
    )
    approach_speed_m_s: Annotated[float, number(1e-3, 0.25, "it hardly moves; speed beside people")] | None = None
    max_steps: Annotated[int, count(1, 2000, "no step; minutes of pushing")] | None = None
    success_depth_m: Annotated[float, number(1e-3, 0.05, "a tilted peg on the rim; deeper than pegs are long")] = 3.0e-3
    retract: bool = True
    conditions: Conditions = "standard"
    plant: PlantField | None = None
    allow_lock: Annotated[tuple[LockMode, ...], Field(min_length=1)] = ("paper",)

    def bears_n(self, cell_ceiling_n: float) -> float:
        """Return the momentary true force that the part bears, N, given the cell's force ceiling."""
        if self.impact_n is not None:
            return self.impact_n
        return IMPACT_SHARE * (cell_ceiling_n if self.force_ceiling_n is None else self.force_ceiling_n)


class SimSection(Section):
    """The simulator of the driver `zenoh_sim`; with an emulated UR controller, the simulator of its world.

    Attributes:
        world: name of the world in the simulator's keys.
        endpoint: Zenoh endpoint that the simulator listens on.
        mode: whether time passes by itself; an emulated UR controller always runs in real time.
        autostart: whether the control process starts the simulator where none listens, and ends it again.
    """

    world: Name = DEFAULT_WORLD
    endpoint: Endpoint = DEFAULT_ENDPOINT
    mode: TimeMode = "real_time"
    autostart: bool = True


class CameraSection(Section):
    """The source of estimates of the hole's position, for a driver whose arm does not give them.

    Attributes:
        endpoint: Zenoh endpoint of the publisher.
        key: key under which it publishes `wire.records.CAMERA` records.
        max_age_s: largest age of an estimate that is used.
    """

    endpoint: Endpoint
    key: Annotated[str, Field(min_length=1, pattern=r"^[^*$#?\s]+$")]
    max_age_s: Annotated[float, number(0.01, 5.0, "no camera is that fast; the hole may have moved")] = 0.2


class TlsSection(Section):
    """Certificates for `tls/` and `quic/` endpoints; `docs/reference/wire-security.md` says how to make them.

    Attributes:
        authority: PEM file of the authority that signed the certificates of all processes.
        certificate: PEM file of this process's certificate.
        key: PEM file of its private key.
        commanders: common names of the certificates that may command: start, stop, reset, claim the simulator.
        readers: common names that may read the state and no more.
    """

    authority: Path
    certificate: Path
    key: Path
    commanders: Annotated[tuple[CommonName, ...], Field(min_length=1)]
    readers: tuple[CommonName, ...] = ()


class ApiSection(Section):
    """The HTTP server.

    Attributes:
        host: address to listen on; one other than loopback needs `allow_remote`.
        port: port to listen on.
        database: SQLAlchemy URL of the run history (SQLite); empty: a file in the state directory.
        autostart: whether the API starts the control process where none answers.
        allow_remote: whether requests from other machines are accepted; there is no authorisation yet.
        allowed_hosts: names in a `Host` header that are accepted besides the loopback ones.
    """

    host: Host = "127.0.0.1"
    port: Port = 8000
    database: str = ""
    autostart: bool = True
    allow_remote: bool = False
    allowed_hosts: tuple[str, ...] = ()


class ClientLossSection(Section):
    """Behaviour of a run when no client is heard any more, whoever started it.

    Attributes:
        policy: `continue` finishes the run, `stop` latches CLIENT_LOST.
        limit_s: silence that counts as loss.
    """

    policy: Literal["continue", "stop"] = "continue"
    limit_s: Annotated[float, number(0.2, 60.0, "clients are heard every 0.1 s; longer than a run")] = 2.0
