"""What an operator asks of the arm's power, brakes and stops, through the dashboard; nothing here happens by itself."""

from service.config import UrSection
from service.drivers.ur.dashboard import DashboardClient, DashboardError, DashboardErrorReason


def dashboard(ur: UrSection) -> DashboardClient:
    """A client of the controller's dashboard server; use it in `async with`."""
    return DashboardClient(ur.host, ur.dashboard_port, reply_timeout_s=ur.connect_s)


async def power_on(ur: UrSection) -> None:
    """Switch the arm on and release its brakes; returns once it holds itself.

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
    """Leave a protective stop whose cause was inspected, with no program; ours is sent again by the next run.

    Raises:
        DashboardError: TOO_EARLY within 5 s of the stop; REFUSED where the arm is in none, or in a worse one.
    """
    async with dashboard(ur) as client:
        status = await client.safety_status()
        if status != "PROTECTIVE_STOP":
            text = f"the safety system says {status}: there is no protective stop to unlock"
            raise DashboardError(DashboardErrorReason.REFUSED, text)
        await _end_program(client)  # one that the stop has paused would go on when somebody presses play
        await client.close_safety_popup()
        await client.unlock_protective_stop()


async def stop_program(ur: UrSection) -> None:
    """Stop whatever program runs or is paused; that there is none is no error.

    Raises:
        DashboardError: the controller cannot be reached.
    """
    async with dashboard(ur) as client:
        await _end_program(client)


async def _end_program(client: DashboardClient) -> None:
    state, _ = await client.program_state()
    if state != "STOPPED":  # `running` says false of a paused one
        await client.stop()
