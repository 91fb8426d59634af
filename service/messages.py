"""Messages between a cell's control process and its clients: JSON under `cell/<id>/`.

| key | kind | request | answer or payload |
|---|---|---|---|
| `command/start` | query | `StartRequest` in an `Envelope` | `RunAnswer` |
| `command/stop` | query | `StopRequest` in an `Envelope` | `StatusAnswer` |
| `command/reset` | query | `ResetRequest` in an `Envelope` | `StatusAnswer` |
| `query/ticket` | query | `TicketRequest` | `TicketResult`, or `Refused` |
| `query/status` | query | empty | `StatusAnswer` |
| `query/runs` | query | `RunsRequest` | `RunsAnswer` |
| `query/run` | query | `RunRequest` | `RunAnswer` |
| `status` | publication, `HEARTBEAT_S`, which is also the heartbeat | | `Status` |
| `event` | publication, as they happen | | `Event` |
| `telemetry` | publication, about 50 Hz | | `Telemetry` |
| `client` | subscription: every client, every `CLIENT_HEARTBEAT_S` | | `Presence` in an `Envelope` |

`service/envelope.py` has the envelope and the tickets. A query by a wildcard is a reading: it commands nothing.
`docs/reference/frames.md` defines frames, units and signs. Times of day are seconds since the Unix epoch.
"""

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from service.faults import FaultCode
from wire.modes import TimeMode

SCHEMA_VERSION = 1
HEARTBEAT_S = 0.05
"""Period of the status publication."""
CLIENT_HEARTBEAT_S = 0.1
"""Period of a client's sign of presence."""

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"
"""Pattern of names of cells and recipes: safe in a key expression, a path and a URL."""

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
    """State of a cell; `service/cell/states.py` has the allowed changes."""

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
    """A client shows a silent cell as UNKNOWN; no cell is ever in this state."""


class RunState(StrEnum):
    """State of a run; all but ACTIVE are final."""

    ACTIVE = "ACTIVE"
    SUCCEEDED = "SUCCEEDED"
    FAILED = "FAILED"
    """The run ended by itself without the peg in the hole; the cell is READY again."""
    STOPPED = "STOPPED"
    """An operator stopped the run, or no client was heard any more."""
    LATCHED = "LATCHED"
    """A fault ended the run and latched the cell."""
    INTERRUPTED = "INTERRUPTED"
    """The control process ended before the run did."""

    @staticmethod
    def ended_by(code: FaultCode) -> "RunState":
        """Return the state of a run that a latching stop with this code has ended."""
        match code:
            case FaultCode.OPERATOR_STOP | FaultCode.CLIENT_LOST:
                return RunState.STOPPED
            case FaultCode.INTERRUPTED:
                return RunState.INTERRUPTED
            case _:
                return RunState.LATCHED


class RefusalReason(StrEnum):
    """Kind of a refusal."""

    INVALID_REQUEST = "INVALID_REQUEST"
    UNKNOWN_RECIPE = "UNKNOWN_RECIPE"
    UNKNOWN_RUN = "UNKNOWN_RUN"
    EXPIRED = "EXPIRED"
    """The request could not be decided before its `valid_until`."""
    STOPPED = "STOPPED"
    """A stop came after the start had been received."""
    WRONG_STATE = "WRONG_STATE"
    LATCHED = "LATCHED"
    NOT_LATCHED = "NOT_LATCHED"
    FORCE_ABOVE_LIMIT = "FORCE_ABOVE_LIMIT"
    NO_MEASUREMENT = "NO_MEASUREMENT"
    """There is no fresh sample of the arm."""
    POLICY_REFUSED = "POLICY_REFUSED"
    STORAGE = "STORAGE"
    """The state directory cannot be written."""
    UNKNOWN_SENDER = "UNKNOWN_SENDER"
    """The command has no ticket of this control process, or one of another sender."""
    REPLAYED = "REPLAYED"
    """The command is a copy of an earlier one."""
    INTERNAL = "INTERNAL"


class Message(BaseModel):
    """Base of every message: immutable, unknown fields refused, no NaN on the wire."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


# --- requests


class StopMark(Message):
    """A place in the order of a cell's stops.

    Attributes:
        service_epoch: identity of the control process that counts.
        stops: stops counted until then: every stop command, and every fault that latched.
    """

    service_epoch: str
    stops: int = Field(ge=0)


class StartRequest(Message):
    """Ask for one insertion.

    Attributes:
        recipe: name of a recipe in the cell's configuration.
        seed: seed of the simulated world; None draws one. A real arm refuses a seed.
        idempotency_key: a second start with the same key starts nothing and is answered with the first one's run.
        requested_by: person or program that asks, for the record.
        after: newest mark that the sender had when it received the start. The start is refused if the cell has counted
            another stop since, or is served by another control process. None: the mark when the request arrives.
        valid_until: time on the control process's clock (`Status.clock_s`) from which the start is refused; None:
            never. It keeps the arm from moving for a request whose sender has given up.
    """

    recipe: str = Field(pattern=NAME_PATTERN)
    seed: int | None = Field(default=None, ge=0, lt=2**63)
    idempotency_key: str | None = Field(default=None, min_length=1, max_length=128)
    requested_by: str = Field(default="", max_length=128)
    after: StopMark | None = None
    valid_until: float | None = None


class StopRequest(Message):
    """Stop whatever moves. Accepted in every state."""

    reason: str = Field(default="", max_length=500)
    requested_by: str = Field(default="", max_length=128)


class ResetRequest(Message):
    """Acknowledge the latched fault; nothing moves.

    Attributes:
        acknowledge: the code that the operator saw; the reset is refused where another is in force. None acknowledges
            any.
        comment: the operator's findings, for the record.
    """

    acknowledge: FaultCode | None = None
    comment: str = Field(default="", max_length=500)
    requested_by: str = Field(default="", max_length=128)


class RunsRequest(Message):
    """Ask for runs, newest first."""

    limit: int = Field(default=50, ge=1, le=500)
    before: str | None = Field(default=None, max_length=64)
    """Id of a run; only older ones are returned."""


class RunRequest(Message):
    """Ask for one run."""

    run_id: str = Field(min_length=1, max_length=64)


# --- publications


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
        seq: place in the order in which the cell accepted its runs; 0 where an older version recorded it.
        code: why it did not succeed; None while it is under way and for a success.
        phase: phase of the dynamic safety lock at the last policy step.
        steps: policy steps taken.
        depth_m: depth of the peg's bottom below the hole's surface at the last policy step, as the cell measures it.
        peak_force_n: largest resultant force of any sample since the run was accepted.
        duration_s: time since the first approach move, on the samples' clock.
        requested_at: time of day at which the run was accepted.
        ended_at: `requested_at` and the time that has passed since on a monotonic clock.
    """

    id: str
    seq: int = 0
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
    """The newest sample of the arm; every value is measured.

    Attributes:
        sample_age_s: time since it arrived, on the cell's clock.
        force_n: (3,) force of the environment on the tool, base frame.
        torque_nm: (3,) about the TCP, base frame.
        tcp_position_m: (3,) base frame.
        tcp_speed_m_s: magnitude of the TCP's translational velocity.
        moving: whether the TCP or a joint moves faster than standstill allows.
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
    """Counts since the control process started."""

    samples: int = 0
    samples_ignored: int = 0
    """Duplicates, and samples older than an earlier one."""
    samples_missed: int = 0
    """Samples missing from the sequence: the arm published them, and they did not arrive."""
    samples_dropped: int = 0
    """Samples that the loop was too slow to take; the largest force among them was judged."""
    telemetry_dropped: int = 0
    loop_overruns: int = 0
    """Turns of the control loop that came more than 20 ms late."""
    loop_late_p99_s: float = 0.0
    """99th percentile of the lateness of the loop's turns in the last 10 s."""
    loop_late_max_s: float = 0.0


class Status(Message):
    """Everything that a client shows of a cell."""

    schema_version: Literal[1] = 1
    cell: str
    service_epoch: str
    """Identity of the control process; another value means that it was restarted."""
    seq: int
    time: float
    clock_s: float
    """Monotonic clock of the control process, s; no clock of day moves it."""
    stops: int
    """Stops counted by this control process, see `StopMark`."""
    state: CellState
    can_start: bool
    why_not: str | None = None
    """Reason why `can_start` is false, for people."""
    latch: Latch | None = None
    run: Run | None = None
    """The run under way, else the last one of this process."""
    measured: Measured | None = None
    driver: str
    mode: TimeMode
    recipes: tuple[str, ...]
    force_ceiling_n: float
    """Force ceiling in force: that of the last run's recipe until the next run or a new link, else the cell's."""
    degradations: tuple[str, ...] = ()
    """Things that this host does not permit (real-time scheduling, say); the cell works less exactly without them."""
    counters: Counters = Counters()

    @property
    def mark(self) -> StopMark:
        """The place of this status in the order of stops."""
        return StopMark(service_epoch=self.service_epoch, stops=self.stops)


class EventKind(StrEnum):
    """Kind of an event."""

    STATE = "STATE"
    RUN = "RUN"
    FAULT = "FAULT"
    RESET = "RESET"
    WARNING = "WARNING"


class Event(Message):
    """One line of the journal. `seq` increases by one within one `service_epoch`."""

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
        force_peak_n: largest |F| of any sample since the last point; thinning out hides no peak.
        tcp_z_m: height of the peg's bottom, base frame.
        z_lock_m: lowest height that the lock permits; None while it seeks, or outside a run.
        depth_m: depth below the hole's surface, as far as the cell knows it; None outside a run.
        phase: phase of the lock.
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
        reason: kind of refusal.
        detail: says what is wrong, where, and what to do about it.
        code: the fault in force, where there is one.
        state: the cell's state when it refused.
        field: the field of the request that is wrong, where one is.
    """

    reason: RefusalReason
    detail: str
    code: FaultCode | None = None
    state: CellState | None = None
    field: str | None = None


class Refused(Message):
    """The cell refused the request."""

    kind: Literal["refused"] = "refused"
    problem: Problem


class StatusResult(Message):
    """The cell did as asked; its status follows."""

    kind: Literal["status"] = "status"
    status: Status


class RunResult(Message):
    """The run that was asked for."""

    kind: Literal["run"] = "run"
    run: Run
    created: bool
    """False for a query, and where an idempotency key found an earlier run."""


class RunsResult(Message):
    """The runs that were asked for."""

    kind: Literal["runs"] = "runs"
    runs: tuple[Run, ...]
    """Newest first."""


StatusAnswer = Annotated[StatusResult | Refused, Field(discriminator="kind")]
RunAnswer = Annotated[RunResult | Refused, Field(discriminator="kind")]
RunsAnswer = Annotated[RunsResult | Refused, Field(discriminator="kind")]

STATUS_ANSWER: TypeAdapter[StatusResult | Refused] = TypeAdapter(StatusAnswer)
RUN_ANSWER: TypeAdapter[RunResult | Refused] = TypeAdapter(RunAnswer)
RUNS_ANSWER: TypeAdapter[RunsResult | Refused] = TypeAdapter(RunsAnswer)
