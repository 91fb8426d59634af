"""What crosses the wire between a cell's control process and its clients: JSON under `cell/<id>/`.

| key | kind | request | answer or payload |
|---|---|---|---|
| `command/start` | query | `StartRequest` | `RunAnswer` |
| `command/stop` | query | `StopRequest` | `StatusAnswer` |
| `command/reset` | query | `ResetRequest` | `StatusAnswer` |
| `query/status` | query | empty | `StatusAnswer` |
| `query/runs` | query | `RunsRequest` | `RunsAnswer` |
| `query/run` | query | `RunRequest` | `RunAnswer` |
| `status` | publication, `HEARTBEAT_S`, which is also the heartbeat | | `Status` |
| `event` | publication, as they happen | | `Event` |
| `telemetry` | publication, about 50 Hz | | `Telemetry` |
| `client` | subscription: a client is there, every `CLIENT_HEARTBEAT_S` | | anything |

Frames, units and signs are those of `docs/reference/frames.md`; times of day are seconds since the Unix epoch.
"""

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from service.faults import FaultCode

SCHEMA_VERSION = 1
HEARTBEAT_S = 0.05
"""Period of the status publication."""
CLIENT_HEARTBEAT_S = 0.1
"""Period in which a client says that it is there."""

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"
"""Cells and recipes: safe in a key expression, a path and a URL."""

START = "cell/{cell}/command/start"
STOP = "cell/{cell}/command/stop"
RESET = "cell/{cell}/command/reset"
QUERY_STATUS = "cell/{cell}/query/status"
QUERY_RUNS = "cell/{cell}/query/runs"
QUERY_RUN = "cell/{cell}/query/run"
STATUS = "cell/{cell}/status"
EVENT = "cell/{cell}/event"
TELEMETRY = "cell/{cell}/telemetry"
CLIENT = "cell/{cell}/client"


class CellState(StrEnum):
    """What the cell is doing; the allowed changes stand in `service/cell/states.py`."""

    OFFLINE = "OFFLINE"
    CONNECTING = "CONNECTING"
    READY = "READY"
    PREFLIGHT = "PREFLIGHT"
    APPROACH = "APPROACH"
    RUNNING = "RUNNING"
    RETRACT = "RETRACT"
    STOPPING = "STOPPING"
    LATCHED = "LATCHED"
    UNKNOWN = "UNKNOWN"
    """Never said by a cell: what a client says of one that is silent."""


class RunState(StrEnum):
    ACTIVE = "ACTIVE"
    SUCCEEDED = "SUCCEEDED"
    FAILED = "FAILED"
    """Ended by itself without the peg in the hole; the cell is READY again."""
    STOPPED = "STOPPED"
    """Stopped by an operator or a client."""
    LATCHED = "LATCHED"
    """Ended by a fault that latched the cell."""
    INTERRUPTED = "INTERRUPTED"
    """The control process ended before the run did."""


class RefusalReason(StrEnum):
    """Why a request was refused."""

    INVALID_REQUEST = "INVALID_REQUEST"
    UNKNOWN_RECIPE = "UNKNOWN_RECIPE"
    UNKNOWN_RUN = "UNKNOWN_RUN"
    EXPIRED = "EXPIRED"
    """The request arrived after the time until which its sender wanted it carried out."""
    WRONG_STATE = "WRONG_STATE"
    LATCHED = "LATCHED"
    NOT_LATCHED = "NOT_LATCHED"
    FORCE_ABOVE_LIMIT = "FORCE_ABOVE_LIMIT"
    NO_MEASUREMENT = "NO_MEASUREMENT"
    """No fresh sample to judge the arm by."""
    POLICY_REFUSED = "POLICY_REFUSED"
    STORAGE = "STORAGE"
    """The state directory cannot take a record of the run."""
    INTERNAL = "INTERNAL"


class Message(BaseModel):
    """Base of every message: immutable, unknown fields refused, no NaN on the wire."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


# --- requests


class StartRequest(Message):
    """Ask for one insertion.

    Attributes:
        recipe: name of a recipe in the cell's configuration.
        seed: of the simulated world; None draws one. A real arm refuses a seed.
        idempotency_key: the same key again answers with the same run and starts nothing.
        requested_by: who asks, for the record.
        valid_until: a start that arrives later than this is refused; None: never too late. So nothing moves for a
            request that lay in a queue while the control process was frozen, and whose sender has given up.
    """

    recipe: str = Field(pattern=NAME_PATTERN)
    seed: int | None = Field(default=None, ge=0, lt=2**63)
    idempotency_key: str | None = Field(default=None, min_length=1, max_length=128)
    requested_by: str = Field(default="", max_length=128)
    valid_until: float | None = None


class StopRequest(Message):
    """Stop whatever moves. Accepted in every state."""

    reason: str = Field(default="", max_length=500)
    requested_by: str = Field(default="", max_length=128)


class ResetRequest(Message):
    """Acknowledge the latched fault; moves nothing.

    Attributes:
        acknowledge: the code that the operator saw; another one in force is refused. None acknowledges any.
        comment: what was found, for the record.
    """

    acknowledge: FaultCode | None = None
    comment: str = Field(default="", max_length=500)
    requested_by: str = Field(default="", max_length=128)


class RunsRequest(Message):
    limit: int = Field(default=50, ge=1, le=500)
    before: str | None = Field(default=None, max_length=64)
    """Only runs older than this one."""


class RunRequest(Message):
    run_id: str = Field(min_length=1, max_length=64)


# --- what is told


class Latch(Message):
    """The latched stop in force."""

    code: FaultCode
    text: str
    latched_at: float
    run_id: str | None = None
    peak_force_n: float | None = None


class Run(Message):
    """One insertion, under way or ended.

    Attributes:
        code: why it did not succeed; None while it is under way and for a success.
        phase: of the dynamic safety lock, at the last policy step.
        steps: policy steps taken.
        depth_m: how far the peg's bottom is, or was at the end, below the hole's surface by the cell's own measure.
        peak_force_n: largest resultant of any sample since the run was accepted.
        duration_s: from the first approach move, on the samples' clock.
    """

    id: str
    recipe: str
    seed: int | None
    state: RunState
    code: FaultCode | None = None
    text: str = ""
    requested_at: float
    ended_at: float | None = None
    requested_by: str = ""
    idempotency_key: str | None = None
    policy_sha256: str | None = None
    phase: str | None = None
    steps: int = 0
    depth_m: float | None = None
    peak_force_n: float = 0.0
    duration_s: float = 0.0


class Measured(Message):
    """The newest sample of the arm: measured, never merely commanded.

    Attributes:
        sample_age_s: time since it arrived, on the cell's clock.
        force_n: (3,) what the environment does to the tool, base frame.
        torque_nm: (3,) about the TCP, base frame.
        tcp_position_m: (3,) base frame.
        tcp_speed_m_s: magnitude of the TCP's translational velocity.
        moving: the TCP or a joint moves faster than standstill allows.
    """

    sample_age_s: float
    sample_seq: int
    force_n: tuple[float, float, float]
    torque_nm: tuple[float, float, float]
    force_magnitude_n: float
    tcp_position_m: tuple[float, float, float]
    tcp_speed_m_s: float
    moving: bool
    program: str
    robot_mode: int
    safety_mode: int


class Counters(Message):
    samples: int = 0
    samples_ignored: int = 0
    """Duplicates and samples older than one already seen."""
    samples_missed: int = 0
    """Gaps in the sequence: published by the arm, never seen here."""
    samples_dropped: int = 0
    """Arrived faster than the loop took them; the largest force among them was judged all the same."""
    telemetry_dropped: int = 0
    loop_overruns: int = 0


class Status(Message):
    """All that a client needs to show of a cell."""

    schema_version: Literal[1] = 1
    cell: str
    service_epoch: str
    """Drawn when the control process starts; another value means that it was restarted."""
    seq: int
    time: float
    state: CellState
    can_start: bool
    why_not: str | None = None
    """Why `can_start` is false, for people."""
    latch: Latch | None = None
    run: Run | None = None
    """The run under way, else the last one of this process."""
    measured: Measured | None = None
    driver: str
    mode: Literal["real_time", "lockstep"]
    recipes: tuple[str, ...]
    force_ceiling_n: float
    """In force: the cell's, or that of the run's recipe, which stays until the next run or a new link."""
    degradations: tuple[str, ...] = ()
    """What this host does not permit (real-time scheduling, say); the cell works without it, less exactly."""
    counters: Counters = Counters()


class EventKind(StrEnum):
    STATE = "STATE"
    RUN = "RUN"
    FAULT = "FAULT"
    RESET = "RESET"
    WARNING = "WARNING"


class Event(Message):
    """Something worth a line in the journal. `seq` increases by one within one `service_epoch`."""

    service_epoch: str
    seq: int
    time: float
    kind: EventKind
    state: CellState
    run_id: str | None = None
    code: FaultCode | None = None
    text: str = ""


class Telemetry(Message):
    """One point of the live plot.

    Attributes:
        t: time of the sample on the arm's clock, s.
        force_peak_n: largest |F| of any sample since the last point, so that thinning out hides no peak.
        tcp_z_m: height of the peg's bottom, base frame.
        z_lock_m: lowest height that the lock permits; None while it seeks, or outside a run.
        depth_m: below the hole's surface as far as the cell knows it; None outside a run.
        phase: of the lock.
    """

    t: float
    force_n: tuple[float, float, float]
    force_magnitude_n: float
    force_peak_n: float
    tcp_z_m: float
    z_lock_m: float | None = None
    depth_m: float | None = None
    phase: str | None = None
    state: CellState
    run_id: str | None = None


# --- answers


class Problem(Message):
    """A refusal.

    Attributes:
        reason: what kind of refusal.
        detail: what is wrong, where, and what to do about it.
        code: the fault in force, where there is one.
        state: the cell's state when it refused.
        field: the request's field that is wrong, where it is one.
    """

    reason: RefusalReason
    detail: str
    code: FaultCode | None = None
    state: CellState | None = None
    field: str | None = None


class Refused(Message):
    kind: Literal["refused"] = "refused"
    problem: Problem


class StatusResult(Message):
    kind: Literal["status"] = "status"
    status: Status


class RunResult(Message):
    kind: Literal["run"] = "run"
    run: Run
    created: bool
    """False where an idempotency key found a run that was there already, and for a query."""


class RunsResult(Message):
    kind: Literal["runs"] = "runs"
    runs: tuple[Run, ...]
    """Newest first."""


StatusAnswer = Annotated[StatusResult | Refused, Field(discriminator="kind")]
RunAnswer = Annotated[RunResult | Refused, Field(discriminator="kind")]
RunsAnswer = Annotated[RunsResult | Refused, Field(discriminator="kind")]

STATUS_ANSWER: TypeAdapter[StatusResult | Refused] = TypeAdapter(StatusAnswer)
RUN_ANSWER: TypeAdapter[RunResult | Refused] = TypeAdapter(RunAnswer)
RUNS_ANSWER: TypeAdapter[RunsResult | Refused] = TypeAdapter(RunsAnswer)
