"""Client of the dashboard server, TCP 29999: power, brakes, stops, programs and the queries before a start.

Each command and each reply is one line; the strings are those of the vendor's dashboard document for e-Series 5.x.
Nothing here retries: only an operator's request unlocks a protective stop.
"""

import asyncio
import contextlib
import re
from enum import StrEnum
from types import TracebackType
from typing import Self

PORT = 29999
REPLY_TIMEOUT_S = 5.0
CONNECT_TIMEOUT_S = 5.0
POLL_S = 0.05
_LINE_BYTES = 16384

_NOT_REMOTE = "please switch robot to Remote Control"
_TOO_EARLY = "Cannot unlock protective stop until 5s"


class DashboardErrorReason(StrEnum):
    """Kinds of `DashboardError`."""

    UNREACHABLE = "unreachable"
    """No connection, or the peer does not greet as a dashboard server."""
    LOST = "lost"
    """The connection ended."""
    TIMEOUT = "timeout"
    """No answer in time, or the arm did not reach the mode in time."""
    NOT_REMOTE = "not_remote"
    """The robot is in local control, or was when this connection was opened."""
    TOO_EARLY = "too_early"
    """The protective stop is younger than 5 s and cannot be unlocked yet."""
    REFUSED = "refused"
    """The controller refused the command for now."""
    UNEXPECTED = "unexpected"
    """An answer that is not in the document."""


class DashboardError(Exception):
    """A dashboard command failed; `reason` gives the kind, the text the command, the reply and the remedy.

    Attributes:
        reason: kind of the failure, for code to match on.
        reply: the controller's line; empty without one.
    """

    def __init__(self, reason: DashboardErrorReason, text: str, reply: str = "") -> None:
        super().__init__(text)
        self.reason = reason
        self.reply = reply


class DashboardClient:
    """One connection to a dashboard server; commands run one after another, in the order of their calls.

    Any error except REFUSED, NOT_REMOTE and TOO_EARLY closes the connection, because a late answer would be taken for
    the answer to the next command.
    """

    def __init__(self, host: str, port: int = PORT, *, reply_timeout_s: float = REPLY_TIMEOUT_S) -> None:
        """Store the server's address; `connect` opens the connection.

        Args:
            host: address of the controller.
            port: port of its dashboard server.
            reply_timeout_s: longest time for an answer, s.
        """
        self._host = host
        self._port = port
        self._timeout_s = reply_timeout_s
        self._turn = asyncio.Lock()
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def __aenter__(self) -> Self:
        await self.connect()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    @property
    def is_connected(self) -> bool:
        return self._streams is not None

    async def connect(self) -> None:
        """Connect and read the greeting; close an open connection first, as is needed after a switch to remote control.

        Raises:
            DashboardError: UNREACHABLE or TIMEOUT.
        """
        await self.close()
        where = f"{self._host}:{self._port}"
        try:
            async with asyncio.timeout(CONNECT_TIMEOUT_S):
                streams = await asyncio.open_connection(self._host, self._port, limit=_LINE_BYTES)
        except TimeoutError as error:
            raise DashboardError(
                DashboardErrorReason.UNREACHABLE, f"no dashboard server answers at {where}; check the address"
            ) from error
        except OSError as error:
            raise DashboardError(
                DashboardErrorReason.UNREACHABLE,
                f"cannot reach the dashboard server at {where}: {error}; is the controller on, the address right?",
            ) from error
        self._streams = streams
        greeting = await self._line(*streams, "the greeting")
        if "Dashboard Server" not in greeting:
            await self.close()
            raise DashboardError(
                DashboardErrorReason.UNREACHABLE, f"{where} greets with {greeting!r}: no dashboard server", greeting
            )

    async def close(self) -> None:
        """Close the connection, if there is one."""
        if (writer := self._drop()) is not None:
            with contextlib.suppress(OSError):  # the peer may have closed first
                await writer.wait_closed()

    async def ask(self, command: str) -> str:
        """Send any command line and return the reply line.

        Raises:
            DashboardError: LOST, TIMEOUT; NOT_REMOTE if the controller says that the command needs remote control.
            ValueError: the command contains an end of line.
        """
        if "\n" in command or "\r" in command:
            raise ValueError(f"a dashboard command is one line, not {command!r}")
        async with self._turn:
            if self._streams is None:
                raise DashboardError(
                    DashboardErrorReason.LOST, f"`{command}`: not connected to the dashboard server; connect first"
                )
            reply = await self._line(*self._streams, f"`{command}`", command.encode() + b"\n")
        if _NOT_REMOTE in reply:
            text = f"`{command}`: the robot is not in remote control; switch it on the pendant, then connect again"
            raise DashboardError(DashboardErrorReason.NOT_REMOTE, text, reply)
        return reply

    # --- arm --------------------------------------------------------------------------------------------------------

    async def power_on(self) -> None:
        """Switch the arm's power on; `wait_for_robot_mode("IDLE", "RUNNING")` waits for the result."""
        await self._expect("power on", "Powering on")

    async def power_off(self) -> None:
        """Switch the arm's power off; the brakes close."""
        await self._expect("power off", "Powering off")

    async def brake_release(self) -> None:
        """Release the brakes, after powering on if needed; the arm then holds itself and is RUNNING."""
        await self._expect("brake release", "Brake releasing")

    async def unlock_protective_stop(self) -> None:
        """End a protective stop after inspection of its cause.

        Raises:
            DashboardError: TOO_EARLY within 5 s of the stop.
        """
        await self._expect("unlock protective stop", "Protective stop releasing")

    async def restart_safety(self) -> None:
        """Restart the safety system after a fault or violation; the arm has no power afterwards."""
        await self._expect("restart safety", "Restarting safety")

    async def robot_mode(self) -> str:
        """Return POWER_OFF, IDLE, RUNNING …, the names in the document."""
        return await self._value("robotmode", r"Robotmode: (\w+)")

    async def safety_status(self) -> str:
        """Return NORMAL, PROTECTIVE_STOP, FAULT …, the names in the document."""
        return await self._value("safetystatus", r"Safetystatus: (\w+)")

    async def wait_for_robot_mode(self, *modes: str, timeout_s: float = 30.0) -> str:
        """Poll until the arm is in one of the modes, and return that mode.

        Raises:
            DashboardError: TIMEOUT; the connection stays open.
        """
        clock = asyncio.get_running_loop().time
        deadline_s = clock() + timeout_s
        while (mode := await self.robot_mode()) not in modes:
            if clock() > deadline_s:
                text = f"the arm stayed in {mode} for {timeout_s:g} s instead of reaching {' or '.join(modes)}"
                raise DashboardError(DashboardErrorReason.TIMEOUT, text)
            await asyncio.sleep(POLL_S)
        return mode

    # --- programs ---------------------------------------------------------------------------------------------------

    async def load(self, program: str) -> None:
        """Load a program file of the controller, such as `insert.urp`."""
        await self._expect(f"load {program}", "Loading program: ")

    async def play(self) -> None:
        """Start or resume the loaded program."""
        await self._expect("play", "Starting program")

    async def pause(self) -> None:
        """Pause the running program; it later resumes the interrupted motion."""
        await self._expect("pause", "Pausing program")

    async def stop(self) -> None:
        """Stop the running program.

        Raises:
            DashboardError: REFUSED if none runs.
        """
        await self._expect("stop", "Stopped")

    async def is_running(self) -> bool:
        """Return True if a program runs, whoever sent it."""
        return await self._value("running", r"Program running: (true|false)") == "true"

    async def program_state(self) -> tuple[str, str]:
        """Return STOPPED, PLAYING or PAUSED, and the name of the loaded program."""
        state, _, name = (await self._value("programState", r"((?:STOPPED|PLAYING|PAUSED).*)")).partition(" ")
        return state, name

    # --- screen and identity ----------------------------------------------------------------------------------------

    async def popup(self, text: str) -> None:
        """Show a message on the pendant."""
        await self._expect(f"popup {text}", "showing popup")

    async def close_popup(self) -> None:
        """Close the message on the pendant."""
        await self._expect("close popup", "closing popup")

    async def close_safety_popup(self) -> None:
        """Close the safety message on the pendant."""
        await self._expect("close safety popup", "closing safety popup")

    async def add_to_log(self, text: str) -> None:
        """Write a line to the controller's log."""
        await self._expect(f"addToLog {text}", "Added log message")

    async def is_in_remote_control(self) -> bool:
        """Return True if commands from the network are accepted; needs PolyScope 5.6."""
        return await self._value("is in remote control", r"(true|false)") == "true"

    async def polyscope_version(self) -> tuple[int, int, int]:
        """Return major, minor and bugfix number."""
        text = await self._value("PolyscopeVersion", r"URSoftware (\d+\.\d+\.\d+)")
        major, minor, bugfix = (int(part) for part in text.split("."))
        return major, minor, bugfix

    async def serial_number(self) -> str:
        """Return the serial number of the arm."""
        return await self._value("get serial number", r"(\d+)")

    async def robot_model(self) -> str:
        """Return UR3, UR5 …; the document's names have no e."""
        return await self._value("get robot model", r"(UR\d+\w*)")

    def _drop(self) -> asyncio.StreamWriter | None:
        streams, self._streams = self._streams, None
        if streams is None:
            return None
        streams[1].close()
        return streams[1]

    async def _expect(self, command: str, beginning: str) -> None:
        reply = await self.ask(command)
        if reply.startswith(beginning):
            return
        if reply.startswith(_TOO_EARLY):
            text = (
                "a protective stop can be unlocked 5 s after it occurred, once its cause was inspected; ask again then"
            )
            raise DashboardError(DashboardErrorReason.TOO_EARLY, text, reply)
        raise DashboardError(DashboardErrorReason.REFUSED, f"`{command}` was refused: {reply}", reply)

    async def _value(self, question: str, pattern: str) -> str:
        reply = await self.ask(question)
        found = re.match(pattern, reply)
        if found is None:
            await self.close()
            raise DashboardError(DashboardErrorReason.UNEXPECTED, f"`{question}` was answered with {reply!r}", reply)
        return found[1]

    async def _line(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, what: str, question: bytes = b""
    ) -> str:
        """Send a command and read a line; on failure close the connection and raise the reason."""
        try:
            if writer.is_closing():
                raise ConnectionError("closed by the controller")  # not every event loop reports this when writing
            writer.write(question)
            async with asyncio.timeout(self._timeout_s):
                line = await reader.readline()
        except TimeoutError as error:
            await self.close()
            text = f"{what} was not answered within {self._timeout_s:g} s"
            raise DashboardError(DashboardErrorReason.TIMEOUT, text) from error
        except (OSError, ValueError) as error:  # readline raises ValueError for a line beyond its limit
            await self.close()
            raise DashboardError(
                DashboardErrorReason.LOST, f"the dashboard connection broke at {what}: {error}"
            ) from error
        except asyncio.CancelledError:  # the answer is still to come and would be taken for the next one
            self._drop()
            raise
        if not line.endswith(b"\n"):
            await self.close()
            raise DashboardError(DashboardErrorReason.LOST, f"the dashboard server closed the connection at {what}")
        return line.decode("utf-8", "replace").rstrip()
