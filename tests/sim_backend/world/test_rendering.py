"""Pictures of the cell, drawn by a process of their own as a user would; skipped only where EGL is missing."""

import os
import subprocess
from pathlib import Path

import mujoco
import numpy as np
import pytest

from service.program import command
from sim_backend.world import appearance, rendering
from sim_backend.zenoh_cell.cell import SimulatedCell
from wire.task import Task

ROOT = Path(__file__).parents[3]


def render(*options: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command("sim", "render", *options),
        cwd=ROOT, env={**os.environ, **environment}, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip


@pytest.fixture(scope="module")
def cell() -> SimulatedCell:
    cell = SimulatedCell("tr")
    cell.reset(Task(3))
    return cell


def drawn(cell: SimulatedCell, camera: str | rendering.View) -> np.ndarray:
    try:
        renderer = rendering.Renderer(cell.part, width=320, height=180)
    except rendering.RenderingUnavailableError as error:
        pytest.skip(str(error))
    with renderer:
        return renderer.draw(cell.model(), cell.data(), camera)


def orange(picture: np.ndarray) -> int:
    """Number of pixels of the peg's colour."""
    red, green, blue = (picture[..., i].astype(int) for i in range(3))
    return int(((red > 90) & (red > 2 * blue) & (red > green + 30)).sum())


@pytest.mark.parametrize("camera", appearance.CAMERAS)
def test_every_camera_shows_the_peg(cell: SimulatedCell, camera: str) -> None:
    picture = drawn(cell, camera)
    assert picture.shape == (180, 320, 3)
    assert orange(picture) > 20


def test_no_large_part_of_a_picture_is_black_or_blown_out(cell: SimulatedCell) -> None:
    for camera in appearance.CAMERAS:
        picture = drawn(cell, camera)
        assert (picture.max(axis=2) < 8).mean() < 0.02, camera
        assert (picture.min(axis=2) > 250).mean() < 0.02, camera


def test_a_picture_follows_the_state(cell: SimulatedCell) -> None:
    other = SimulatedCell("tr")
    other.reset(Task(4))
    assert not np.array_equal(drawn(cell, "hole"), drawn(other, "hole"))


def test_a_camera_that_is_not_there_is_named(cell: SimulatedCell) -> None:
    with pytest.raises(ValueError, match="no camera 'ceiling' in the scene, it has overview"):
        drawn(cell, "ceiling")


def test_the_command_writes_a_png(tmp_path: Path) -> None:
    out = tmp_path / "cell.png"
    process = render("--seed", "3", "--part", "cir", "--out", str(out), "--width", "64", "--height", "36")
    if process.returncode == 3:
        pytest.skip(process.stderr)
    assert process.returncode == 0, process.stderr
    content = out.read_bytes()
    assert content.startswith(b"\x89PNG\r\n\x1a\n")
    assert content[16:24] == (64).to_bytes(4, "big") + (36).to_bytes(4, "big")


@pytest.mark.parametrize(
    ("environment", "code", "named"),
    [
        ({"MUJOCO_GL": "glfw"}, 3, "'glfw' is not an off-screen backend"),
        ({"MUJOCO_EGL_DEVICE_ID": "99"}, 3, "apt-get install"),
        ({"PYOPENGL_PLATFORM": "glx"}, 3, "apt-get install"),
    ],
)
def test_a_machine_that_cannot_draw_says_so(tmp_path: Path, environment: dict[str, str], code: int, named: str) -> None:
    process = render("--out", str(tmp_path / "cell.png"), **environment)
    assert process.returncode == code
    assert named in process.stderr
    assert "Traceback" not in process.stderr


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    process = render("--out", str(tmp_path / "absent" / "cell.png"), "--width", "16", "--height", "16")
    assert process.returncode in (2, 3)
    assert "Traceback" not in process.stderr
    if process.returncode == 2:
        assert "absent" in process.stderr


def test_serving_needs_no_rendering() -> None:
    process = subprocess.run(
        command("sim", "serve", "--help"),
        cwd=ROOT, env={**os.environ, "MUJOCO_GL": "osmesa"}, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr


def test_a_camera_of_ones_own_looks_where_it_is_told(cell: SimulatedCell) -> None:
    model, data = cell.model(), cell.data()
    mujoco.mj_kinematics(model, data)
    peg = np.add(data.body("peg").xpos, [0.0, 0.0, 0.02])
    near, far, elsewhere = (
        orange(drawn(cell, rendering.View(tuple(target), distance, 180.0, -20.0)))
        for target, distance in ((peg, 0.2), (peg, 0.6), (np.add(peg, [0.0, 0.5, 0.0]), 0.2))
    )
    assert near > 4 * far > 0
    assert elsewhere == 0
