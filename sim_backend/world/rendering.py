"""Off-screen pictures of a scene. Only this module needs EGL (or OSMesa)."""

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from sim_backend.world import appearance, scene

_REMEDY = "On Debian: apt-get install -y libegl1 libgl1 (software rendering, no GPU needed)"


class RenderingUnavailableError(RuntimeError):
    """This machine cannot render; the text says why and what to install."""


@dataclass(frozen=True, slots=True)
class View:
    """A camera with free position and direction.

    Attributes:
        target: point at the centre of the picture, base frame, m.
        distance_m: distance from the target.
        azimuth_deg: direction of the line of sight about z, from x.
        elevation_deg: elevation of the line of sight; negative looks down.
    """

    target: tuple[float, float, float]
    distance_m: float
    azimuth_deg: float
    elevation_deg: float


class Renderer:
    """Draws states of a cell from its named cameras or from a `View`. A context manager; use it from one thread."""

    def __init__(
        self, part: str = "tr", clearance_m: float = 2e-3, width: int = 1280, height: int = 720, backend: str = "egl"
    ) -> None:
        """Make an OpenGL context and a dressed scene; the states to draw come from plain scenes.

        Args:
            part: peg and hole.
            clearance_m: clearance per face, m.
            width: width of the pictures, pixels.
            height: height of the pictures, pixels.
            backend: `egl` or `osmesa`.

        Raises:
            RenderingUnavailableError: this machine cannot make such a context.
        """
        self._gl = _new_context(backend, width, height)
        spec = scene.specify(part, clearance_m)
        appearance.dress(spec, part, clearance_m)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._viewport = mujoco.MjrRect(0, 0, width, height)
        self._scene = mujoco.MjvScene(self._model, 1000)
        self._option = mujoco.MjvOption()
        self._option.sitegroup[:] = 0
        self._context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_150.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        mujoco.mjr_resizeOffscreen(width, height, self._context)

    def __enter__(self) -> "Renderer":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def draw(
        self, model: mujoco.MjModel, state: mujoco.MjData, camera: str | View = "overview"
    ) -> npt.NDArray[np.uint8]:
        """Draw a state.

        Args:
            model: model of a cell with this part; only the grasp is read from it. The walls are those of `clearance_m`.
            state: state of that cell; only its positions are read.
            camera: one of `appearance.CAMERAS`, or a `View`.

        Returns:
            (height, width, 3) uint8, RGB, top row first.

        Raises:
            ValueError: the scene has no such camera.
        """
        if isinstance(camera, str) and camera not in appearance.CAMERAS:
            raise ValueError(f"no camera {camera!r} in the scene, it has {', '.join(appearance.CAMERAS)}")
        self._model.body("peg").pos = model.body("peg").pos
        data = self._data
        data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = state.qpos, state.mocap_pos, state.mocap_quat
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)
        mujoco.mj_camlight(self._model, data)
        view = mujoco.MjvCamera()
        if isinstance(camera, str):
            view.type = mujoco.mjtCamera.mjCAMERA_FIXED
            view.fixedcamid = self._model.camera(camera).id
        else:
            view.type = mujoco.mjtCamera.mjCAMERA_FREE
            view.lookat[:] = camera.target
            view.distance, view.azimuth, view.elevation = camera.distance_m, camera.azimuth_deg, camera.elevation_deg
        mujoco.mjv_updateScene(
            self._model, data, self._option, None, view, mujoco.mjtCatBit.mjCAT_ALL.value, self._scene
        )
        self._gl.make_current()
        mujoco.mjr_render(self._viewport, self._scene, self._context)
        picture = np.empty((self._viewport.height, self._viewport.width, 3), np.uint8)
        mujoco.mjr_readPixels(picture, None, self._viewport, self._context)
        return np.ascontiguousarray(picture[::-1])

    def close(self) -> None:
        """Free the context; the renderer cannot draw afterwards."""
        self._context.free()
        self._gl.free()


def write_png(path: Path, picture: npt.NDArray[np.uint8]) -> None:
    """Write (height, width, 3) uint8 RGB as PNG (RFC 2083); this spares an imaging library at run time."""
    height, width, _ = picture.shape
    rows = np.zeros((height, 1 + 3 * width), np.uint8)  # each row starts with its filter type, 0: none
    rows[:, 1:] = picture.reshape(height, 3 * width)

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)  # 8 bits per channel, colour type 2: RGB
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows.tobytes(), 9)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)


def _new_context(backend: str, width: int, height: int) -> Any:
    """Return a current off-screen OpenGL context without mujoco's own choice of backend, which is fixed at import."""
    if backend not in ("egl", "osmesa"):
        raise RenderingUnavailableError(f"{backend!r} is not an off-screen backend, use egl or osmesa")
    try:
        if backend == "egl":
            from mujoco.egl import GLContext
        else:
            from mujoco.osmesa import GLContext
        context = GLContext(width, height)
        context.make_current()
    except Exception as error:  # missing libraries raise ImportError, AttributeError, TypeError or PyOpenGL's own
        raise RenderingUnavailableError(f"no {backend} rendering on this machine ({error}). {_REMEDY}") from error
    return context
