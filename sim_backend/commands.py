"""`sim …`: the simulated cell, served over Zenoh (`serve`) or over UR's own protocols (`ur-controller`), or drawn."""

import contextlib
import os
import signal
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from types import FrameType
from typing import Annotated, NoReturn, get_args

# ruff: noqa: E402
# `import mujoco` would load a backend: the one that is named, or fail, else GLFW, which starts a process to learn its
# version. The renderer alone needs one.
_BACKEND = os.environ.get("MUJOCO_GL", "egl")
os.environ["MUJOCO_GL"] = "disable"

import typer
import zenoh

from sim_backend.world import appearance, compiled, rendering
from sim_backend.zenoh_cell.cell import SimulatedCell
from sim_backend.zenoh_cell.server import Pace, Server

del os.environ["MUJOCO_GL"]

from wire.endpoints import (
    DEFAULT_ENDPOINT,
    DEFAULT_WORLD,
    EndpointError,
    EndpointInUseError,
    check_endpoint,
    check_host,
)
from wire.exits import Exit
from wire.realtime import SIMULATOR_PRIORITY, request_realtime
from wire.session import open_session
from wire.task import Part, Task
from wire.tls import Access, Certificates, is_encrypted

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Serve a simulated cell, or an emulated UR controller, or draw it.",
)
_PARTS = ", ".join(get_args(Part))
_Authority = Annotated[Path | None, typer.Option(help="PEM file of the authority, for tls/ endpoints.")]
_Certificate = Annotated[Path | None, typer.Option(help="PEM file of this process's certificate.")]
_Key = Annotated[Path | None, typer.Option(help="PEM file of its private key.")]
_Commander = Annotated[
    list[str] | None, typer.Option(help="Common name of a certificate that may command; may be repeated.")
]
_Reader = Annotated[list[str] | None, typer.Option(help="Common name that may read only; may be repeated.")]
_Realtime = Annotated[
    bool, typer.Option("--realtime", help="Ask for real-time scheduling, below that of a control process.")
]


@app.command()
def serve(
    world: Annotated[str, typer.Option(help="Name of the world in its Zenoh keys, sim/<world>/….")] = DEFAULT_WORLD,
    mode: Annotated[Pace, typer.Option(help="Clock of simulated time: the wall clock, or the client.")] = (
        Pace.REAL_TIME
    ),
    listen: Annotated[
        list[str] | None, typer.Option(help=f"Endpoint to listen at, {DEFAULT_ENDPOINT} unless given; may be repeated.")
    ] = None,
    connect: Annotated[list[str] | None, typer.Option(help="Endpoint to join; may be repeated.")] = None,
    part: Annotated[str, typer.Option(help=f"Peg and hole of the first episode: {_PARTS}.")] = "tr",
    seed: Annotated[int, typer.Option(help="Seed of the first episode.")] = 0,
    realtime: _Realtime = False,
    allow_remote: Annotated[bool, typer.Option(help="Allow endpoints outside this machine.")] = False,
    authority: _Authority = None,
    certificate: _Certificate = None,
    key: _Key = None,
    commander: _Commander = None,
    reader: _Reader = None,
) -> None:
    """Serve a simulated cell over Zenoh until SIGINT or SIGTERM."""
    _exit_on_signals()
    endpoints = listen or [DEFAULT_ENDPOINT]
    try:
        task = Task.from_json({"seed": seed, "part": part})
        # before Zenoh starts its threads: the loop sometimes waits for them, and ordinary priority would delay it
        refused = request_realtime(SIMULATOR_PRIORITY) if realtime and mode is Pace.REAL_TIME else ()
        security = _security(world, endpoints, (authority, certificate, key), commander or [], reader or [])
        session = _open_session(endpoints, connect or [], security, allow_remote=allow_remote)
    except ValueError as error:
        _fail(str(error), Exit.USAGE)
    with session:
        cell = SimulatedCell(task.part)
        cell.reset(task)
        _say_what_is_missing(refused)
        try:
            server = Server(cell, session, world, mode, refused)
        except ValueError as error:
            _fail(str(error), Exit.USAGE)
        typer.echo(f"ready world={world} mode={mode} epoch={cell.epoch} listen={','.join(endpoints)}")
        sys.stdout.flush()
        server.run()


@app.command("ur-controller")
def ur_controller(
    host: Annotated[
        str, typer.Option(help="Loopback address of this machine to listen on, with UR's ports.")
    ] = "127.0.0.1",
    any_ports: Annotated[
        bool, typer.Option(help="Take free ports instead of UR's; the ready line names them.")
    ] = False,
    part: Annotated[str, typer.Option(help=f"Peg and hole of the first episode: {_PARTS}.")] = "tr",
    seed: Annotated[int, typer.Option(help="Seed of the first episode.")] = 0,
    world: Annotated[str, typer.Option(help="Name of the world in its Zenoh keys, sim/<world>/….")] = DEFAULT_WORLD,
    listen: Annotated[
        list[str] | None, typer.Option(help="Zenoh endpoint for the arm's surroundings; none by default.")
    ] = None,
    connect: Annotated[list[str] | None, typer.Option(help="Zenoh endpoint to join; none unless given.")] = None,
    programs: Annotated[
        Path | None, typer.Option(help="Folder of URScript files: NAME.script can be loaded as NAME.urp.")
    ] = None,
    realtime: _Realtime = False,
    allow_remote: Annotated[bool, typer.Option(help="Allow addresses outside this machine.")] = False,
    authority: _Authority = None,
    certificate: _Certificate = None,
    key: _Key = None,
    commander: _Commander = None,
    reader: _Reader = None,
) -> None:
    """Serve an emulated e-Series controller of the simulated arm until SIGINT, SIGTERM or a client's shutdown."""
    _exit_on_signals()
    # Loaded here, because a world over Zenoh starts without them in half the time
    from sim_backend.ur_controller.assembly import make_controller
    from sim_backend.ur_controller.plant import Plant
    from sim_backend.ur_controller.server import ANY_PORTS, ControllerServer, Ports
    from sim_backend.ur_controller.surroundings import Surroundings
    from sim_backend.world.world import World

    with contextlib.ExitStack() as stack:
        try:
            task = Task.from_json({"seed": seed, "part": part})
            check_host(host, allow_remote=allow_remote)
            refused = request_realtime(SIMULATOR_PRIORITY) if realtime else ()  # before Zenoh starts, as in `serve`
            session = None
            if listen or connect:
                security = _security(world, listen or [], (authority, certificate, key), commander or [], reader or [])
                opened = _open_session(listen or [], connect or [], security, allow_remote=allow_remote)
                session = stack.enter_context(opened)
            plant = Plant(World(1, task.part))
            plant.lay_out(task)
            controller = make_controller(plant)
            if programs is not None:
                controller.programs |= _read_programs(programs)
            server = stack.enter_context(
                contextlib.closing(ControllerServer(controller, host, ANY_PORTS if any_ports else Ports()))
            )
            surroundings = Surroundings(controller, server, session, world, refused) if session is not None else None
        except (OSError, ValueError) as error:
            _fail(str(error), Exit.USAGE)
        if surroundings is not None:
            stack.enter_context(contextlib.closing(surroundings))
        _say_what_is_missing(refused)
        ready = {"host": host, **asdict(server.ports)}
        if surroundings is not None:
            ready |= {"world": world, "epoch": surroundings.epoch, "listen": ",".join(listen or [])}
        typer.echo(" ".join(["ready", *(f"{name}={value}" for name, value in ready.items())]))
        sys.stdout.flush()
        server.run(surroundings)


def _say_what_is_missing(refused: Sequence[str]) -> None:
    for line in refused:
        typer.echo(f"degraded: {line}", err=True)
    if compiled.tick is None:
        typer.echo(compiled.describe(), err=True)


def _read_programs(folder: Path) -> dict[str, str]:
    files = sorted(folder.glob("*.script"))
    if not files:
        raise ValueError(f"no *.script file in {folder}")
    return {f"{file.stem}.urp": file.read_text(encoding="utf-8") for file in files}


@app.command()
def render(
    out: Annotated[Path, typer.Option(help="PNG file to write.")],
    seed: Annotated[int, typer.Option(help="Seed of the episode.")] = 0,
    part: Annotated[str, typer.Option(help=f"Peg and hole: {_PARTS}.")] = "tr",
    clearance_m: Annotated[float, typer.Option(help="Clearance per face, m.")] = 2e-3,
    camera: Annotated[str, typer.Option(help=f"One of {', '.join(appearance.CAMERAS)}.")] = "overview",
    width: Annotated[int, typer.Option(min=16, max=1920, help="Width of the picture, px.")] = 1280,
    height: Annotated[int, typer.Option(min=16, max=1080, help="Height of the picture, px.")] = 720,
) -> None:
    """Draw the start of an episode."""
    try:
        task = Task.from_json({"seed": seed, "part": part, "clearance_m": clearance_m})
        cell = SimulatedCell(task.part)
        cell.reset(task)
        with rendering.Renderer(task.part, task.clearance_m, width, height, _BACKEND) as renderer:
            picture = renderer.draw(cell.model(), cell.data(), camera)
        rendering.write_png(out, picture)
    except rendering.RenderingUnavailableError as error:
        _fail(str(error), Exit.HOST)
    except (ValueError, OSError) as error:
        _fail(str(error), Exit.USAGE)
    typer.echo(f"wrote {out} ({width}x{height}, {camera})")


def _security(
    world: str, listen: list[str], files: tuple[Path | None, ...], commanders: list[str], readers: list[str]
) -> tuple[Certificates | None, Access | None]:
    """Return the certificates, and the rights of the peers that connect to encrypted endpoints.

    Raises:
        EndpointError: an option is missing.
    """
    given = [file for file in files if file is not None]
    encrypted = any(is_encrypted(endpoint) for endpoint in listen)
    if encrypted and not (len(given) == len(files) and commanders):
        raise EndpointError("a tls/ endpoint needs --authority, --certificate, --key and at least one --commander")
    certificates = Certificates(*given) if len(given) == len(files) else None
    access = Access(f"sim/{world}", ("info", "truth"), commanders, readers) if encrypted else None
    return certificates, access


def _open_session(
    listen: list[str],
    connect: list[str],
    security: tuple[Certificates | None, Access | None],
    *,
    allow_remote: bool,
) -> zenoh.Session:
    """Open a session whose endpoints stay on this machine unless `allow_remote`.

    Raises:
        EndpointError: an endpoint is refused, malformed or taken.
    """
    for endpoint in (*listen, *connect):
        check_endpoint(endpoint, allow_remote=allow_remote)
    try:
        return open_session(listen, connect, *security)
    except EndpointInUseError as error:
        raise EndpointError(f"{error}: choose another --listen") from error


def _exit_on_signals() -> None:
    """Turn the first SIGINT or SIGTERM into SystemExit, so that the session closes on exit; ignore later ones."""

    def leave(_number: int, _frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        raise SystemExit(0)

    signal.signal(signal.SIGINT, leave)
    signal.signal(signal.SIGTERM, leave)


def _fail(text: str, code: Exit) -> NoReturn:
    typer.echo(f"sim: {text}", err=True)
    raise typer.Exit(code)
