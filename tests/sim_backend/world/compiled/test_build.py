"""The extension is built where there is a compiler; without it, or with one of other sources, numpy computes."""

import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim_backend.world import compiled
from sim_backend.world.sensor import MAX_DELAY
from sim_backend.world.world import World
from tests.sim_backend.world.compiled.twins import assert_equal, needs_the_extension, of_world, twins
from wire import extension

ROOT = Path(__file__).resolve().parents[4]
FOLDER = Path(compiled.__file__).parent
COMPILER = str(sysconfig.get_config_var("CC") or "cc").split()[0]


STEP = Path("service/policy/compiled")

needs_a_compiler = pytest.mark.skipif(shutil.which(COMPILER) is None, reason=f"there is no {COMPILER}")


def build(folder: Path, compiler: str | None = None, flags: str = "", root: Path = ROOT) -> list[Path]:
    """Build the sources below `root` as an installation does, into a folder; return what was built."""
    pytest.importorskip("setuptools")
    program = [sys.executable, "setup.py", "--quiet", "build_ext", f"--build-lib={folder}", f"--build-temp={folder}/o"]
    environment = os.environ | ({"CC": compiler, "LDSHARED": f"{compiler} -shared"} if compiler else {})
    environment |= {"CFLAGS": flags} if flags else {}
    done = subprocess.run(program, cwd=root, env=environment, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    return sorted(folder.rglob("*.so"))


def run(program: str) -> str:
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@needs_a_compiler
def test_an_installation_builds_the_extensions_of_the_present_sources(tmp_path: Path) -> None:
    built = {path.name.partition(".")[0]: path for path in build(tmp_path)}
    assert set(built) == {"_tick", "_step"}
    for name, folder in (("_tick", FOLDER), ("_step", ROOT / STEP)):
        assert sources(built[name]) == extension.digest(folder)


def only_step(built: list[Path]) -> Path:
    return next(path for path in built if path.name.startswith("_step"))


def sources(built: Path) -> str:
    """Return the digest that an extension carries."""
    name = built.name.partition(".")[0]
    return run(f"import sys; sys.path.insert(0, {str(built.parent)!r}); import {name}; print({name}.SOURCES)")


@needs_a_compiler
def test_flags_of_the_environment_change_no_number(tmp_path: Path) -> None:
    """`-ffast-math` takes numbers that are none for numbers; `-march=native` fuses on processors that can."""
    built = build(tmp_path, flags="-O3 -ffast-math -march=native")
    if not built:
        pytest.skip(f"{COMPILER} does not know these flags")
    run(
        "import importlib.util, sys; import numpy as np; name = 'service.policy.compiled._step'; "
        f"spec = importlib.util.spec_from_file_location(name, {str(only_step(built))!r}); "
        "sys.modules[name] = importlib.util.module_from_spec(spec); spec.loader.exec_module(sys.modules[name]); "
        "from tests.service.policy.compiled import test_equality as equality; "
        "assert equality.compiled.step is sys.modules[name]; "
        "equality.test_every_shipped_contract_is_played_the_same('vftm-dsl', ()); "
        "equality.test_every_shipped_contract_is_played_the_same('vftm-dsl', (7,))"
    )


@needs_a_compiler
def test_other_flags_are_another_extension_and_are_built_anew(tmp_path: Path) -> None:
    tree, setting = tmp_path / "tree", "wire/extension.py"
    for path in ("setup.py", setting, *(str(path.relative_to(ROOT)) for path in (ROOT / "wire").glob("*.h"))):
        (tree / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / path, tree / path)
    shutil.copytree(ROOT / STEP, tree / STEP, ignore=shutil.ignore_patterns("*.so"))
    before = sources(only_step(build(tmp_path / "built", root=tree)))
    (tree / setting).write_text((ROOT / setting).read_text().replace('"-O2"', '"-O1"'))
    assert sources(only_step(build(tmp_path / "built", root=tree))) != before


def test_without_a_compiler_an_installation_goes_on(tmp_path: Path) -> None:
    assert build(tmp_path, compiler="/no/such/compiler") == []


def test_an_extension_that_is_not_there_is_said_to_be_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    tick, absence = compiled.load("sim_backend.world.compiled._not_built")
    assert tick is None
    monkeypatch.setattr(compiled, "tick", tick)
    monkeypatch.setattr(compiled, "absence", absence)
    assert "not built" in compiled.describe()
    assert "make -B setup" in compiled.describe()


@needs_the_extension
def test_an_extension_of_other_sources_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    assert compiled.load() == (compiled.tick, "")
    monkeypatch.setattr(extension, "digest", lambda folder: "of a later file")
    assert compiled.load() == (None, "it was built from other sources")


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("", "it was built from other sources"),
        ("raise ImportError('no such symbol')", "it is not built: no such symbol"),
        ("raise SystemError('of another interpreter')", "it cannot be loaded: SystemError('of another interpreter')"),
        ("import numpy; numpy.no_such_function", "it cannot be loaded: AttributeError"),
    ],
)
def test_an_extension_that_is_none_of_ours_or_fails_to_load_is_not_used(
    content: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "strange_extension.py").write_text(content)
    monkeypatch.syspath_prepend(tmp_path)
    tick, absence = compiled.load("strange_extension")
    sys.modules.pop("strange_extension", None)
    assert tick is None
    assert absence.startswith(reason)


@needs_the_extension
def test_what_computes_the_ticks_is_said() -> None:
    assert compiled.describe() == "simulated ticks: compiled"


def test_a_file_of_c_that_changes_changes_the_digest(tmp_path: Path) -> None:
    for path in FOLDER.glob("*.[ch]"):
        shutil.copy(path, tmp_path)
    assert extension.digest(tmp_path) == extension.digest(FOLDER)
    with (tmp_path / "linear.h").open("a") as file:
        file.write("\n")
    assert extension.digest(tmp_path) != extension.digest(FOLDER)


def test_a_shared_header_that_changes_changes_the_digest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = extension.digest(FOLDER)
    shutil.copy(extension.SHARED / "loops.h", tmp_path)
    monkeypatch.setattr(extension, "SHARED", tmp_path)
    assert extension.digest(FOLDER) == before
    (tmp_path / "loops.h").write_text("/* other loops */\n")
    assert extension.digest(FOLDER) != before


@needs_the_extension
def test_arrays_that_do_not_fit_are_refused_before_anything_is_written() -> None:
    world = World(2)
    arm, tick = world.arm, compiled.tick
    assert tick is not None
    good = [world.joints, world.sensor.wrench, world.position, np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)), np.zeros(2, bool)]
    before = arm._age.copy()
    for place, bad in (
        (0, good[0][:1]),
        (0, good[0].astype(np.float32)),
        (1, good[1].T.copy().T),
        (2, good[2][:, :2]),
        (3, [1.0, 0.0, 0.0, 0.0]),
        (4, np.zeros(2)),
    ):
        given = [*good[:place], bad, *good[place + 1 :]]
        with pytest.raises(TypeError, match=r"array|layout"):
            tick.lead(*arm.bound, *given)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="tuple"):
        tick.lead(arm.bound[0][:-1], arm.bound[1], *good)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="constants"):
        tick.lead(arm.bound[0], arm.bound[1][1:], *good)  # type: ignore[arg-type]
    frozen = np.zeros((2, 6))
    frozen.setflags(write=False)
    with pytest.raises(TypeError, match="read-only"):
        tick.follow(*arm.bound, arm._jacobians, frozen)
    assert (arm._age == before).all()


def other(names: tuple[str, ...], name: str, array: np.ndarray) -> Callable[[tuple[np.ndarray, ...]], Any]:
    """Return a function that puts another array in the place of one."""
    return lambda given: tuple(array if found == name else one for found, one in zip(names, given, strict=True))


def constant(sizes: Mapping[str, int], name: str, value: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function that changes the first number of a constant."""
    place = [one for one, size in sizes.items() for _ in range(size)].index(name)
    return lambda given: np.concatenate([given[:place], [value], given[place + 1 :]])


@needs_the_extension
def test_what_would_lead_beyond_an_array_is_refused() -> None:
    world, tick = World(2), compiled.tick
    assert tick is not None
    n, sensor, load, due = 2, world.sensor.bound, np.zeros((2, 6)), world.arm._jacobians
    effort, noise = tuple(array for array in world.drives), np.zeros((2, 6))
    drives = (np.zeros((n, 6)), np.zeros((n, 3))), np.zeros(sum(tick.DRIVES_CONSTANTS.values()))
    report = tuple(np.zeros((n, *shape)) for shape in [(6,), (6,), (3,), (3,), (6,), (3,), (3,), (6,), (6,), (3,), ()])
    told, measured, one = world.telling._arrays, (world._arrays, world._constants), world._together
    assert one is not None
    call = (*world.arm.bound, *measured, *sensor, one._arrays, one._constants, one._call)
    kept, shown = other(tick.SENSOR, "history", np.zeros((n, 2, 6))), other(tick.CELLS, "jitter", np.zeros((n, 0, 3)))
    bad: list[tuple[Callable[..., Any], tuple[Any, ...], str]] = [
        (tick.sense, (*sensor, load, -1), "no slot -1"),
        (tick.sense, (*sensor, load, MAX_DELAY), f"no slot {MAX_DELAY}"),
        (tick.sense, (kept(sensor[0]), sensor[1], load, 2), "no slot 2"),
        (tick.sense, (other(tick.SENSOR, "history", np.zeros((n, 5)))(sensor[0]), sensor[1], load, 0), "history"),
        (
            tick.sense,
            (other(tick.SENSOR, "noise", np.zeros((n, 0, 6), np.float32))(sensor[0]), sensor[1], load, 0),
            "noise",
        ),
        (tick.sense, (*sensor, load[:1], 0), "carried"),
        (tick.sense, (*sensor, np.zeros((3, 6)), 0), "carried"),
        (tick.measure, (shown(measured[0]), measured[1]), "jitter"),
        (tick.measure, (other(tick.CELLS, "qpos", np.zeros((n, 5)))(measured[0]), measured[1]), "qpos"),
        (tick.measure, (measured[0], constant(tick.CELLS_CONSTANTS, "estimate_ticks", 0.0)(measured[1])), "no ticks"),
        (tick.tell, (other(tick.TELLING, "qvel", np.zeros((n, 5)))(told), report), "qvel"),
        (tick.feel, (*drives, tuple(one[:, :5] for one in effort), noise), "joints"),
        (tick.feel, (*drives, (effort[0], effort[1][:, :5], *effort[2:]), noise), "speeds"),
        (tick.follow, (*world.arm.bound, due[:1], np.zeros((n, 6))), "1 inverses, not 2"),
        (tick.advance, (*call, np.zeros((5, n, 6))[:0], 0, lambda _: None), "no readings"),
        (tick.advance, (*call, np.zeros((5, n, 6)), MAX_DELAY, lambda _: None), f"no slot {MAX_DELAY}"),
        (tick.advance, (*call[:-1], call[-1][1:], np.zeros((5, n, 6)), 0, lambda _: None), "constants"),
        (tick.advance, (*call, np.zeros((5, n + 1, 6)), 0, lambda _: None), "readings"),
    ]
    for period in (0.0, -3.0, np.nan, np.inf):
        constants = constant(tick.ARM_CONSTANTS, "kinematics_ticks", period)(world.arm.bound[1])
        bad.append((tick.follow, (world.arm.bound[0], constants, due, np.zeros((n, 6))), "no ticks"))
    for function, given, text in bad:
        with pytest.raises((TypeError, ValueError), match=text):
            function(*given)


@needs_the_extension
def test_sensors_and_cameras_count_from_below_zero_as_numpy_does() -> None:
    worlds = twins(lambda: World(3))
    for world in worlds:
        world.ticks[:] = -1, -22, -1_000_003
        world.sensor._tick[:] = world.ticks
        for _ in range(30):
            world.tick()
    assert_equal(of_world(worlds[0]), of_world(worlds[1]), "the end")
