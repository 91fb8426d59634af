"""Configuration of a cell: one TOML file, overridden by the environment. Errors name the field.

The file is `$DSL_ASSEMBLY_CONFIG`, else `cell.toml`, else `config/cell.toml`. A variable such as
`DSL_ASSEMBLY__API__PORT=8001` overrides one field. Relative paths are relative to the file.
"""

import os
from pathlib import Path
from typing import Annotated, Any, Literal, Self, assert_never

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict, TomlConfigSettingsSource

from service.messages import NAME_PATTERN
from service.program import PROGRAM
from wire.endpoints import DEFAULT_ENDPOINT, DEFAULT_WORLD
from wire.limits import (
    FORCE_HARD_MAXIMUM_N,
    MAX_SPEED,
    MAX_STEP,
    TARGET_AGE_S,
    TILT_RAD,
    TORQUE_CEILING_NM,
    TORQUE_HARD_MAXIMUM_NM,
    YAW_HALF_RANGE_RAD,
)
from wire.modes import LockMode, TimeMode
from wire.task import Conditions

PATH_VARIABLE = "DSL_ASSEMBLY_CONFIG"
DEFAULT_PATHS = (Path("cell.toml"), Path("config/cell.toml"))
"""Looked for in the working directory: in a cell's own folder, and in a checkout of this project."""


class ConfigError(ValueError):
    """The configuration cannot be used; the text names every field that is wrong."""


def _check_box(box: tuple[tuple[float, float, float], tuple[float, float, float]]) -> Any:
    lower, upper = box
    if any(low >= high for low, high in zip(lower, upper, strict=True)):
        raise ValueError("the lower corner must lie below the upper corner on every axis")
    return box


Force = Annotated[float, Field(gt=0.0, le=FORCE_HARD_MAXIMUM_N, allow_inf_nan=False)]
Torque = Annotated[float, Field(gt=0.0, le=TORQUE_HARD_MAXIMUM_NM, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Position = tuple[Finite, Finite, Finite]
Box = Annotated[tuple[Position, Position], AfterValidator(_check_box)]
SixPositive = tuple[Positive, Positive, Positive, Positive, Positive, Positive]
Name = Annotated[str, Field(pattern=NAME_PATTERN)]
Port = Annotated[int, Field(ge=1, le=65535)]
Endpoint = Annotated[str, Field(pattern=r"^(tcp|tls|quic|unixsock-stream)/\S+$")]


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class CellSection(Section):
    """Identity of the cell and address of its control process.

    Attributes:
        id: name of the cell in keys, paths and URLs.
        endpoint: Zenoh endpoint that the control process listens on.
        driver: `zenoh_sim` for a simulated cell over Zenoh, `ur` for an e-Series controller, real or emulated.
        state_dir: folder of latch and ledger.
    """

    id: Name
    endpoint: Endpoint = "tcp/127.0.0.1:7447"
    driver: Literal["zenoh_sim", "ur"] = "zenoh_sim"
    state_dir: Path


class LimitsSection(Section):
    """Limits that no run may exceed.

    Attributes:
        force_ceiling_n: largest resultant force of any single sample, N.
        torque_ceiling_nm: largest resultant torque at the TCP of any single sample, N·m.
        sample_age_s: age of the newest sample, and gap between two, at which the cell latches STALE.
        stuck_samples: samples in a row, bit-identical in all forces or all torques, at which the cell latches
            SENSOR_STUCK.
        stuck_channel_samples: the same for one channel. A sensor that is quantised more coarsely than its noise needs
            more.
        target_age_s: time without a target after which the arm's own controller stops.
        max_step_m: largest change between two targets, and largest distance of a target from the measured position.
        max_turn_rad: the same for the yaw.
        max_speed_m_s: largest speed of targets and of the arm's reference.
        max_turn_speed_rad_s: the same for the yaw.
        max_tilt_rad: largest tilt of the tool from straight down.
        max_stiffness: N/m and N·m/rad. A policy that wants more is refused.
        min_damping: N·s/m and N·m·s/rad. A policy that wants less is refused: the arm would swing.
        max_damping: a policy that wants more is refused: the arm would hardly yield.
        min_inertia: kg and kg·m². A policy that wants less is refused, for the same reason.
        max_inertia: a policy that wants more is refused: an impact would be hard.
        max_press_m: how far a policy's lock may press below the height of a contact.
        max_contact_share: largest `dsl.contact_threshold` of a policy's clips, as a share of force ceiling and torque
            ceiling: the lock must feel a contact long before the cell stops for it.
        max_seek_step_m: largest step downwards of a policy's lock while it seeks.
        max_lift_m: largest height above the first contact to which a policy's lock may rise.
        max_search_depth_m: largest depth of one stretch of a policy's search for contact.
        max_search_steps: largest length of one, policy steps.
        max_hole_offset_m: largest distance of the camera's estimate of the hole from the nominal one, per axis;
            beyond it the run fails before any motion.
        workspace_m: lower and upper corner of the box in which the TCP stays, base frame.
        yaw_range_rad: largest turn from the start yaw, either way.
        clamped_steps: outrageous policy steps in a row before the cell latches BOUNDS.
        stop_confirm_s: time in which standstill must be measured after a stop.
        policy_deadline_s: time of one inference at which the cell latches POLICY_DEADLINE.
    """

    force_ceiling_n: Force
    torque_ceiling_nm: Torque = TORQUE_CEILING_NM
    sample_age_s: Annotated[float, Field(ge=0.006, le=0.5, allow_inf_nan=False)] = 0.05
    stuck_samples: Annotated[int, Field(ge=2, le=500)] = 10
    stuck_channel_samples: Annotated[int, Field(ge=2, le=500)] = 25
    target_age_s: Annotated[float, Field(ge=0.02, le=1.0, allow_inf_nan=False)] = TARGET_AGE_S
    max_step_m: Annotated[float, Field(gt=0.0, le=0.05, allow_inf_nan=False)] = MAX_STEP[0]
    max_turn_rad: Annotated[float, Field(gt=0.0, le=0.5, allow_inf_nan=False)] = MAX_STEP[1]
    max_speed_m_s: Annotated[float, Field(gt=0.0, le=0.25, allow_inf_nan=False)] = MAX_SPEED[0]
    max_turn_speed_rad_s: Annotated[float, Field(gt=0.0, le=3.0, allow_inf_nan=False)] = MAX_SPEED[1]
    max_tilt_rad: Annotated[float, Field(gt=0.0, le=0.5, allow_inf_nan=False)] = TILT_RAD
    max_stiffness: SixPositive = (3000.0, 3000.0, 3000.0, 100.0, 100.0, 100.0)
    min_damping: SixPositive = (60.0, 60.0, 60.0, 0.1, 0.1, 0.1)
    max_damping: SixPositive = (2000.0, 2000.0, 2000.0, 5.0, 5.0, 5.0)
    min_inertia: SixPositive = (0.5, 0.5, 0.5, 0.01, 0.01, 0.005)
    max_inertia: SixPositive = (10.0, 10.0, 10.0, 0.2, 0.2, 0.2)
    max_press_m: Annotated[float, Field(gt=0.0, le=0.02, allow_inf_nan=False)] = 5e-3
    max_contact_share: Annotated[float, Field(gt=0.0, le=1.0, allow_inf_nan=False)] = 1.0 / 3.0
    max_seek_step_m: Annotated[float, Field(gt=0.0, le=0.02, allow_inf_nan=False)] = 5e-3
    max_lift_m: Annotated[float, Field(gt=0.0, le=0.05, allow_inf_nan=False)] = 0.01
    max_search_depth_m: Annotated[float, Field(gt=0.0, le=0.2, allow_inf_nan=False)] = 0.1
    max_search_steps: Annotated[int, Field(ge=1, le=2000)] = 200
    max_hole_offset_m: tuple[Positive, Positive, Positive] = (0.08, 0.06, 0.05)
    workspace_m: Box
    yaw_range_rad: Annotated[float, Field(gt=0.0, le=3.14159, allow_inf_nan=False)] = YAW_HALF_RANGE_RAD
    clamped_steps: Annotated[int, Field(ge=1, le=100)] = 5
    stop_confirm_s: Annotated[float, Field(ge=0.05, le=2.0, allow_inf_nan=False)] = 0.5
    policy_deadline_s: Annotated[float, Field(ge=0.005, le=0.5, allow_inf_nan=False)] = 0.12


class PreflightSection(Section):
    """Requirements on sensor and pose before the arm moves; `service/safety/preflight.py` checks them.

    Attributes:
        window_samples: number of samples that are judged.
        contact_force_n: mean resultant force that means that something touches the tool.
        bias_force_n: largest mean resultant force after zeroing.
        bias_torque_nm: the same for torque.
        noise_force_n: largest standard deviation of a component.
        noise_torque_nm: the same for torque.
        position_m: largest distance from the start position.
        yaw_rad: largest turn from the start yaw.
        tilt_rad: largest tilt.
        unzeroed_force_n: mean resultant force before zeroing that means that something loads the tool.
        unzeroed_torque_nm: the same for torque.
    """

    window_samples: Annotated[int, Field(ge=10, le=1000)] = 100
    contact_force_n: Force = 3.0
    bias_force_n: Force = 1.5
    bias_torque_nm: Torque = 0.3
    noise_force_n: Force = 1.5
    noise_torque_nm: Torque = 0.4
    position_m: Positive = 5e-3
    yaw_rad: Positive = 0.05
    tilt_rad: Positive = 0.02
    unzeroed_force_n: Force = 12.0
    unzeroed_torque_nm: Positive = 2.5


class WitnessSection(Section):
    """Agreement of the force/torque sensor with the arm's joints, for an arm that gives their forces.

    `service/safety/witness.py` compares them.

    Attributes:
        force_n: difference of their forces at which the cell latches SENSOR_INVALID.
        time_s: time constant of the mean over which they are compared.
        rest_force_n: largest force that the joints may feel before a run, with the configured payload and a free tool.
    """

    force_n: Annotated[float, Field(gt=0.0, le=30.0, allow_inf_nan=False)] = 12.0
    time_s: Annotated[float, Field(ge=0.002, le=0.1, allow_inf_nan=False)] = 0.01
    rest_force_n: Annotated[float, Field(gt=0.0, le=30.0, allow_inf_nan=False)] = 6.0


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
        approach_speed_m_s: speed of the scripted moves.
        max_steps: policy steps before the run fails, where fewer than the policy's own.
        success_depth_m: depth of the peg's bottom below the surface that counts as inserted.
        retract: whether the tool moves up at the end of a run; otherwise it stays where the run ended.
        conditions: distributions from which a simulated world is drawn.
        allow_lock: modes of the safety lock that the policy may use.
    """

    part: Name
    clearance_m: Annotated[float, Field(ge=0.05e-3, le=6e-3, allow_inf_nan=False)]
    policy: Path
    policy_sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None = None
    force_ceiling_n: Force | None = None
    start_position_m: Position
    start_yaw_rad: Finite
    nominal_hole_m: Position
    hover_m: Annotated[float, Field(ge=0.005, le=0.1, allow_inf_nan=False)] = 0.025
    approach_speed_m_s: Annotated[float, Field(gt=0.0, le=0.25, allow_inf_nan=False)] = 0.08
    max_steps: Annotated[int, Field(ge=1, le=2000)] | None = None
    success_depth_m: Annotated[float, Field(gt=0.0, le=0.05, allow_inf_nan=False)] = 3.0e-3
    retract: bool = True
    conditions: Conditions = "standard"
    allow_lock: Annotated[tuple[LockMode, ...], Field(min_length=1)] = ("paper",)


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


class UrSection(Section):
    """A Universal Robots e-Series controller; `docs/how-to/commission-a-ur.md` explains how to find each number.

    Attributes:
        host: address of the controller.
        rtde_port: port of its real-time data exchange.
        dashboard_port: port of its dashboard server.
        primary_port: port of its primary interface, which takes the control program.
        gripper_port: port of the URCap of a Robotiq gripper, for `dsl-assembly ur gripper`.
        model: model that must answer, as the dashboard names it: UR3 for a UR3e; None: any.
        serial: serial number that must answer; None: any.
        simulated: whether it is the emulated controller of this project, whose world is laid out from a seed; `sim`
            then names that world.
        payload_kg: mass of everything that the flange carries.
        payload_com_m: centre of that mass, flange axes.
        tcp_m: pose of the TCP in the flange's frame: m, and a rotation vector in rad.
        torque_about: point to which the controller's torque refers; on the e-Series, the flange.
        force_range_n: end of the sensor's range, per channel of force.
        torque_range_nm: the same for torque.
        watchdog_hz: the control program ends when fewer packages per second than this come from the host.
        stop_retract_m: height by which the arm moves up after a stop by force; 0: it does not.
        prove_watchdog: whether each start lets the watchdog trip once; None: only where the controller is simulated.
        connect_s: longest time that the controller may take for one answer.
    """

    host: str
    rtde_port: Port = 30004
    dashboard_port: Port = 29999
    primary_port: Port = 30001
    gripper_port: Port = 63352
    model: Annotated[str, Field(pattern=r"^UR\d+\w*$")] | None = None
    serial: Annotated[str, Field(pattern=r"^\d+$")] | None = None
    simulated: bool = False
    payload_kg: Annotated[float, Field(ge=0.0, le=50.0, allow_inf_nan=False)]
    payload_com_m: Position
    tcp_m: tuple[Finite, Finite, Finite, Finite, Finite, Finite]
    torque_about: Literal["flange", "tcp"] = "flange"
    force_range_n: Positive = 30.0
    torque_range_nm: Positive = 10.0
    watchdog_hz: Annotated[float, Field(ge=2.0, le=50.0, allow_inf_nan=False)] = 10.0
    stop_retract_m: Annotated[float, Field(ge=0.0, le=0.02, allow_inf_nan=False)] = 0.0
    prove_watchdog: bool | None = None
    connect_s: Annotated[float, Field(ge=0.5, le=30.0, allow_inf_nan=False)] = 3.0


class CameraSection(Section):
    """The source of estimates of the hole's position, for a driver whose arm does not give them.

    Attributes:
        endpoint: Zenoh endpoint of the publisher.
        key: key under which it publishes `wire.records.CAMERA` records.
        max_age_s: largest age of an estimate that is used.
    """

    endpoint: Endpoint
    key: Annotated[str, Field(min_length=1, pattern=r"^[^*$#?\s]+$")]
    max_age_s: Annotated[float, Field(gt=0.0, le=5.0, allow_inf_nan=False)] = 0.2


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

    host: str = "127.0.0.1"
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
    limit_s: Annotated[float, Field(ge=0.2, le=60.0, allow_inf_nan=False)] = 2.0


class CellConfig(BaseSettings):
    """The configuration of one cell."""

    model_config = SettingsConfigDict(
        env_prefix="DSL_ASSEMBLY__", env_nested_delimiter="__", extra="forbid", frozen=True, validate_default=True
    )

    cell: CellSection
    limits: LimitsSection
    preflight: PreflightSection = PreflightSection()
    witness: WitnessSection = WitnessSection()
    sim: SimSection = SimSection()
    ur: UrSection | None = None
    camera: CameraSection | None = None
    api: ApiSection = ApiSection()
    client_loss: ClientLossSection = ClientLossSection()
    recipes: Annotated[dict[Name, RecipeSection], Field(min_length=1)]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for name, recipe in self.recipes.items():
            ceiling = recipe.force_ceiling_n
            if ceiling is not None and ceiling > self.limits.force_ceiling_n:
                raise ValueError(
                    f"recipes.{name}.force_ceiling_n is {ceiling} N, above limits.force_ceiling_n "
                    f"({self.limits.force_ceiling_n} N)"
                )
            if recipe.approach_speed_m_s > self.limits.max_speed_m_s:
                raise ValueError(
                    f"recipes.{name}.approach_speed_m_s is {recipe.approach_speed_m_s}, above limits.max_speed_m_s "
                    f"({self.limits.max_speed_m_s})"
                )
        if self.preflight.bias_force_n >= self.preflight.contact_force_n:
            raise ValueError("preflight.bias_force_n must be below preflight.contact_force_n")
        if self.limits.stuck_channel_samples < self.limits.stuck_samples:
            raise ValueError("limits.stuck_channel_samples must not be below limits.stuck_samples")
        if self.limits.policy_deadline_s >= self.limits.target_age_s:
            raise ValueError("limits.policy_deadline_s must be below limits.target_age_s, or the arm stops first")
        limits = self.limits
        for name, least, most in (
            ("damping", limits.min_damping, limits.max_damping),
            ("inertia", limits.min_inertia, limits.max_inertia),
        ):
            if any(low > high for low, high in zip(least, most, strict=True)):
                raise ValueError(f"limits.min_{name} must not be above limits.max_{name} on any axis")
        if self.cell.driver == "ur" and self.ur is None:
            raise ValueError(
                "cell.driver is ur, so the section [ur] must say where the controller is and what it carries"
            )
        return self

    @property
    def sees_hole(self) -> bool:
        """True where something estimates the hole's position: the simulated cell's camera, or that of `[camera]`."""
        match self.cell.driver:
            case "zenoh_sim":
                return True
            case "ur":
                return self.camera is not None
            case _ as never:
                assert_never(never)

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        return (env_settings, init_settings)


def find(path: Path | None = None) -> Path:
    """Return the absolute path of the configuration: `path`, else `$DSL_ASSEMBLY_CONFIG`, else one of `DEFAULT_PATHS`.

    Raises:
        ConfigError: nothing names one, and the working directory has none, or more than one.
    """
    if path is None and (named := os.environ.get(PATH_VARIABLE)) is not None:
        path = Path(named)
    if path is None:
        found = [default for default in DEFAULT_PATHS if default.is_file()]
        if len(found) > 1:
            raise ConfigError(f"{' and '.join(map(str, found))} are both in {Path.cwd()}: name one by --config")
        if not found:
            raise ConfigError(
                f"no configuration: there is no {' and no '.join(map(str, DEFAULT_PATHS))} in {Path.cwd()}; name one "
                f"by --config or ${PATH_VARIABLE}, or write a cell's folder: {PROGRAM} config new FOLDER"
            )
        path = found[0]
    return path.resolve()


def load(path: Path | None = None) -> CellConfig:
    """Read and check the configuration.

    Args:
        path: the TOML file; None takes the one that `find` finds.

    Raises:
        ConfigError: no such file, not TOML, or a field that is missing, unknown or out of range.
    """
    path = find(path)
    if not path.is_file():
        raise ConfigError(f"no configuration at {path}; to write a cell's folder: {PROGRAM} config new FOLDER")
    try:
        document = TomlConfigSettingsSource(CellConfig, path)()
    except ValueError as error:
        raise ConfigError(f"{path} is not TOML: {error}") from error
    try:
        return _with_absolute_paths(CellConfig(**document), path.parent)
    except ValidationError as error:
        lines = [f"  {_field(problem['loc'])}: {_said(problem)}" for problem in error.errors()]
        raise ConfigError("\n".join([f"{path} cannot be used:", *lines])) from error


def _field(location: tuple[int | str, ...]) -> str:
    return ".".join(str(part) for part in location) or "(whole file)"


def _said(problem: ErrorDetails) -> str:
    if problem["type"] == "extra_forbidden":
        return f"no such field; `{PROGRAM} config schema` lists them"
    if problem["type"] == "value_error":
        return problem["msg"].removeprefix("Value error, ")
    given = f", not {problem['input']!r}" if isinstance(problem["input"], str | int | float) else ""
    return problem["msg"] + given


def _with_absolute_paths(config: CellConfig, base: Path) -> CellConfig:
    cell = config.cell.model_copy(update={"state_dir": (base / config.cell.state_dir).resolve()})
    recipes = {
        name: recipe.model_copy(update={"policy": (base / recipe.policy).resolve()})
        for name, recipe in config.recipes.items()
    }
    return config.model_copy(update={"cell": cell, "recipes": recipes})
