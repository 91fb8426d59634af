"""An operator's requests about the arm's power, brakes and stops, through the dashboard; nothing here is automatic."""

from service.config import UrSection
from service.drivers.ur.dashboard import DashboardClient, DashboardError, DashboardErrorReason


def dashboard(ur: UrSection) -> DashboardClient:
    """Return a client of the controller's dashboard server; use it in `async with`."""
    return DashboardClient(ur.host, ur.dashboard_port, reply_timeout_s=ur.connect_s)


async def power_on(ur: UrSection) -> None:
    """Switch the arm on and release its brakes; return once the arm holds itself.

    Raises:
        DashboardError: the text says what to do.
    """
    async with dashboard(ur) as client:
        status = await client.safety_status()
        if status in ("FAULT", "VIOLATION"):
            await client.close_safety_popup()
            await client.restart_safety()
            await client.wait_for_robot_mode("POWER_OFF")
        if await client.robot_mode() != "RUNNING":
            await client.power_on()
            await client.wait_for_robot_mode("IDLE", "RUNNING")
            await client.brake_release()
            await client.wait_for_robot_mode("RUNNING")


async def power_off(ur: UrSection) -> None:
    """Switch the arm off; its brakes close.

    Raises:
        DashboardError: the text says what to do.
    """
    async with dashboard(ur) as client:
        await client.power_off()
        await client.wait_for_robot_mode("POWER_OFF")


async def unlock(ur: UrSection) -> None:
    """Leave a protective stop after inspection of its cause. The next run sends the control program again.

    Raises:
        DashboardError: TOO_EARLY within 5 s of the stop; REFUSED if the arm is in none, or in a graver one.
    """
    async with dashboard(ur) as client:
        status = await client.safety_status()
        if status != "PROTECTIVE_STOP":
            text = f"the safety system says {status}: there is no protective stop to unlock"
            raise DashboardError(DashboardErrorReason.REFUSED, text)
        await _end_program(client)  # a program paused by the stop would continue when somebody presses play
        await client.close_safety_popup()
        await client.unlock_protective_stop()


async def stop_program(ur: UrSection) -> None:
    """Stop any running or paused program; it is no error if there is none.

    Raises:
        DashboardError: the controller cannot be reached.
    """
    async with dashboard(ur) as client:
        await _end_program(client)


async def _end_program(client: DashboardClient) -> None:
    state, _ = await client.program_state()
    if state != "STOPPED":  # `running` says false for a paused program
        await client.stop()
