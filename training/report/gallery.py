"""Pictures of insertions: a policy's episode as an animation and as a strip of six frames, one per part.

`sim_backend.world.rendering` draws them and needs EGL. World, arm and policy are those of every evaluation.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from service.policy.model import Policy
from sim_backend.world.rendering import Renderer, View
from sim_backend.world.world import World
from training.environment.insertion import Insertions
from training.evaluation.evaluate import evaluate
from wire.task import Conditions, Part, Task

SEATED_DEPTH_M = 15e-3
"""Depth until which an insertion is shown: the 4 mm that end an episode are hardly visible."""
FRAME_SIZE = (400, 300)
"""Width and height of a frame of the animation, pixels; the strip has two rows of three."""
STRIP_COLUMNS, STRIP_ROWS = 3, 2
COLOURS = 96
HELD_MS = 1500
"""Duration of the last frame of an animation."""
_INK, _PAPER = (20, 22, 24), (255, 255, 255)
_PAGE = """# Insertions

Each film shows one test episode in the simulated cell, in real time; policy: {policies}. It is the insertion of median
length among the first test episodes with its part. The line below a frame gives the time, the depth of the peg's bottom
below the hole's mouth and the largest force until then. `dsl-assembly gallery MODEL` draws this page anew.

| part | clearance per face | conditions, seed | inserted after | peak force | |
|---|---|---|---|---|---|
{rows}
"""


@dataclass(frozen=True, slots=True)
class Shot:
    """One frame: the camera's picture after `time_s`, the depth of the peg and the peak force until then."""

    picture: npt.NDArray[np.uint8]
    time_s: float
    depth_m: float
    peak_force_n: float


@dataclass(frozen=True, slots=True)
class Film:
    """An episode in pictures.

    Attributes:
        task: task of the episode.
        policy: name of the policy.
        period_s: time from shot to shot.
        shots: the shots; the first is from before the first step.
        inserted_s: time at which the episode ended with the peg in; None: it did not.
    """

    task: Task
    policy: str
    period_s: float
    shots: tuple[Shot, ...]
    inserted_s: float | None


def typical_success(policy: Policy, part: Part, clearance_m: float, conditions: Conditions, seeds: int) -> Task | None:
    """Return the insertion of median length among the first `seeds` test episodes; None if none of them inserts."""
    played = evaluate(policy, clearance_m, seeds, part=part, conditions=conditions, cells=seeds, threads=1)
    inserted = sorted((episode.steps, episode.seed) for episode in played.episodes if episode.success)
    if not inserted:
        return None
    return Task(inserted[len(inserted) // 2][1], part, clearance_m, conditions)


def film(policy: Policy, task: Task, size: tuple[int, int] = FRAME_SIZE) -> Film:
    """Play an episode and draw it after every policy step; a success is played on until the peg is seated.

    The camera looks at the hole from a side where a gripper turned like the hole hides neither peg nor hole.

    Raises:
        sim_backend.world.rendering.RenderingUnavailableError: this machine cannot draw; the text says what to install.
    """
    cells = Insertions(policy.contract, 1, task.part)
    world, period = cells.world, policy.contract.period_s
    observation = cells.reset(np.arange(1), [task])
    hidden = policy.initial_hidden((1,))
    camera = _facing(world)
    shots: list[Shot] = []
    inserted: float | None = None
    with Renderer(task.part, task.clearance_m, *size) as renderer:

        def shoot() -> None:
            picture = renderer.draw(world.model(), world.data(), camera)
            shots.append(Shot(picture, len(shots) * period, float(world.depth[0]), float(cells.peak_force[0])))

        shoot()
        for _ in range(policy.contract.max_steps):
            action, hidden = policy.act(observation, hidden)
            outcome = cells.step(action)
            observation = outcome.observation
            shoot()
            if inserted is None and outcome.success[0]:
                inserted = shots[-1].time_s
            if outcome.fault[0] or outcome.depth[0] >= SEATED_DEPTH_M:
                break
    return Film(task, policy.contract.name, period, tuple(shots), inserted)


def write_animation(path: Path, film: Film) -> None:
    """Write a film as an animated GIF that loops in real time."""
    frames = [_captioned(shot, film) for shot in film.shots]
    # one palette for all frames avoids flicker and keeps the file small
    palette = frames[len(frames) // 2].quantize(COLOURS, Image.Quantize.MEDIANCUT)
    drawn = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    period_ms = round(1e3 * film.period_s)
    durations = [period_ms] * (len(drawn) - 1) + [HELD_MS]
    drawn[0].save(path, save_all=True, append_images=drawn[1:], duration=durations, loop=0, optimize=True)


def write_strip(path: Path, film: Film) -> None:
    """Write six frames of a film, evenly spaced from the first to the last, as one PNG."""
    count = STRIP_COLUMNS * STRIP_ROWS
    last = len(film.shots) - 1
    frames = [_captioned(film.shots[round(i * last / (count - 1))], film) for i in range(count)]
    width, height = frames[0].size
    gap = 4
    strip = Image.new("RGB", (STRIP_COLUMNS * (width + gap) - gap, STRIP_ROWS * (height + gap) - gap), _PAPER)
    for index, frame in enumerate(frames):
        row, column = divmod(index, STRIP_COLUMNS)
        strip.paste(frame, (column * (width + gap), row * (height + gap)))
    strip.quantize(256, Image.Quantize.MEDIANCUT).save(path, optimize=True)


def page(films: Sequence[Film]) -> str:
    """Return a Markdown page that shows films whose files lie beside it as PART.gif and PART.png."""
    rows: list[str] = []
    for film in films:
        task, peak_n = film.task, film.shots[-1].peak_force_n
        after = "–" if film.inserted_s is None else f"{film.inserted_s:.1f} s"
        rows.append(
            f"| [{task.part}]({task.part}.png) | {1e3 * task.clearance_m:g} mm | {task.conditions}, {task.seed} | "
            f"{after} | {peak_n:.1f} N | ![{task.part}]({task.part}.gif) |"
        )
    policies = ", ".join(dict.fromkeys(film.policy for film in films))
    return _PAGE.format(policies=policies, rows="\n".join(rows))


def _facing(world: World) -> View:
    x, y, z = world.hole_position[0].tolist()
    return View((x, y, z + 0.014), 0.185, 168.0 + math.degrees(float(world.hole_yaw[0])), -33.0)


def _captioned(shot: Shot, film: Film) -> Image.Image:
    """Return a frame with a line below it: time, depth, peak force so far."""
    picture = Image.fromarray(shot.picture)
    bar = max(18, picture.height // 14)
    image = Image.new("RGB", (picture.width, picture.height + bar), _PAPER)
    image.paste(picture, (0, 0))
    font = ImageFont.load_default(size=0.62 * bar)
    state = "inserted" if film.inserted_s is not None and shot.time_s >= film.inserted_s else ""
    depth_mm = round(1e3 * shot.depth_m, 1) + 0.0  # no minus zero
    text = f"{shot.time_s:4.1f} s   depth {depth_mm:5.1f} mm   peak {shot.peak_force_n:4.1f} N   {state}"
    ImageDraw.Draw(image).text((8, picture.height + 0.14 * bar), text, fill=_INK, font=font)
    return image
