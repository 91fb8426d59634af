import subprocess
import sys
from pathlib import Path

import pytest
from typer.core import TyperGroup

from cli.__main__ import COMMANDS
from cli.lazy import load
from service.program import PROGRAM, command
from tests.cli.serving import run

HEAVY = {"fastapi", "gymnasium", "httpx", "matplotlib", "mujoco", "numpy", "onnxruntime", "torch", "zenoh"}
EXTRA = ("PIL", "gymnasium", "matplotlib", "onnx", "tensorboard", "torch", "tqdm")
ROOT = Path(__file__).parents[2]


def python(program: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["stop", "--help"], ["no-such-command"]])
def test_help_and_the_way_to_a_stop_load_nothing_heavy(arguments: list[str]) -> None:
    needed = {"numpy"} if arguments == ["--version"] else set()  # it says whether the compiled tick is used
    done = python(f"""
import sys
from cli.__main__ import app
try:
    app({arguments})
finally:
    print("loaded:", *{{name.split(".")[0] for name in sys.modules}})
""")
    loaded = set(done.stdout.rpartition("loaded:")[2].split())
    assert "typer" in loaded, done.stderr
    assert not loaded & HEAVY - needed


def test_the_help_lists_every_command() -> None:
    listed = run("--help").stdout
    assert not [name for name in COMMANDS if f" {name} " not in listed]


@pytest.mark.parametrize("name", COMMANDS)
def test_what_the_list_says_of_a_command_is_how_its_own_help_begins(name: str) -> None:
    loaded = load(COMMANDS[name], name)
    assert loaded.name == name
    assert " ".join((loaded.help or "").split()).startswith(COMMANDS[name].help.rstrip("."))
    if isinstance(loaded, TyperGroup):
        assert all(found.help for found in loaded.commands.values())


def test_the_program_that_processes_are_started_by_is_this_one() -> None:
    done = subprocess.run(command("--version"), capture_output=True, text=True, timeout=60, cwd="/")
    assert done.stdout.startswith(PROGRAM), done.stderr


def test_a_file_in_the_working_directory_does_not_take_the_place_of_the_program(tmp_path: Path) -> None:
    (tmp_path / "cli.py").write_text("raise SystemExit('not this one')")
    done = subprocess.run(command("--version"), capture_output=True, text=True, timeout=60, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


def test_a_command_that_is_not_there_is_a_usage_error_that_names_a_near_one() -> None:
    done = run("stat")
    assert done.exit_code == 2
    assert "status" in done.output


@pytest.mark.parametrize(
    "arguments",
    [
        ["train", "vftm-dsl-fast"],
        ["export", "x.pt", "x.onnx"],
        ["report"],
        ["baseline", "still", "x.onnx"],
        ["gallery", "x.onnx"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_where_the_training_extra_is_not_installed_its_commands_say_so_in_one_line(arguments: list[str]) -> None:
    done = python(
        f"import sys; sys.modules.update(dict.fromkeys({EXTRA})); from cli.__main__ import app; app({arguments})"
    )
    assert done.returncode == 2, done.stderr
    assert "it needs the extra `training`" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_the_reference_names_every_command_and_every_option() -> None:
    page = next((ROOT / "docs").rglob("command.md")).read_text()
    sections = {part.partition("`")[0]: part.partition("\n")[2] for part in page.split("### `dsl-assembly ")[1:]}
    found = {name: load(entry, name) for name, entry in COMMANDS.items()}
    for name, group in list(found.items()):
        if isinstance(group, TyperGroup):
            del found[name]
            found |= {f"{name} {part}": member for part, member in group.commands.items()}
    assert sections.keys() == found.keys()
    for name, loaded in found.items():
        options = {option for parameter in loaded.params for option in parameter.opts if option.startswith("--")}
        assert not [option for option in options - {"--help"} if f"`{option}`" not in sections[name]], name
