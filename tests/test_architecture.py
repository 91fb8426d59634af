"""The directions of docs/explanation/architecture.md and the house rules, where a tool can hold them."""

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from service.faults import FaultCode

ROOT = Path(__file__).resolve().parents[1]
RUNTIME = ("wire", "service", "sim_backend", "api")
PACKAGES = (*RUNTIME, "training", "benchmarks", "cli")
MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
RUNTIME_MODULES = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for path in MODULES
    if path.relative_to(ROOT).parts[0] in RUNTIME
]
EXAMPLES = sorted((ROOT / "examples").rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), ROOT / "examples/README.md"])
LINK = re.compile(r"\]\(([^)\s]+)\)|<img[^>]+src=\"([^\"]+)\"")


def imported(source: Path) -> set[str]:
    """Return the dotted names that a module imports."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add("." * node.level + (node.module or ""))
    return names


def loaded_by(*modules: str) -> set[str]:
    """Return the top-level modules in a fresh interpreter that has imported `modules`."""
    program = f"import sys, {', '.join(modules)}; print('\\n'.join(sorted({{m.split('.')[0] for m in sys.modules}})))"
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


def test_imports_run_in_the_declared_directions() -> None:
    tool = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run([tool, "--no-cache"], cwd=ROOT, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stdout[done.stdout.find("Contracts\n") :]


def test_the_wire_schema_loads_without_mujoco_and_zenoh() -> None:
    assert not loaded_by("wire.records", "wire.keys", "wire.task") & {
        "mujoco",
        "zenoh",
    }


def test_nothing_at_run_time_loads_what_only_training_needs() -> None:
    assert not loaded_by(*RUNTIME_MODULES) & {"torch", "gymnasium", "tensorboard", "onnx", "matplotlib", "tqdm"}


def test_the_api_loads_no_simulator_and_no_inference() -> None:
    assert not loaded_by(*(m for m in RUNTIME_MODULES if m.split(".")[0] == "api")) & {"mujoco", "onnxruntime"}


@pytest.mark.parametrize(
    ("module", "unwanted"),
    [
        ("sim_backend.commands", "sim_backend.ur_controller"),
        ("service.commands.drivers", "service.drivers.ur"),
        ("service.drivers.watchdog", "pydantic"),
    ],
)
def test_a_process_that_starts_loads_only_what_it_uses(module: str, unwanted: str) -> None:
    program = f"import sys, {module}; print('{unwanted}' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=100)
    assert done.stdout == "False\n", done.stderr


@pytest.mark.parametrize("module", sorted((ROOT / "service/safety").glob("*.py")), ids=lambda path: path.stem)
def test_safety_imports_numpy_faults_and_arithmetic_only(module: Path) -> None:
    allowed = {
        "collections.abc",
        "dataclasses",
        "enum",
        "functools",
        "math",
        "typing",
        "numpy",
        "numpy.typing",
        "service.faults",
        "wire.arrays",
        "wire.impact",
        "wire.law",
        "wire.limits",
        "wire.modes",
        "wire.records",
        "wire.task",
    }
    foreign = {name for name in imported(module) if name not in allowed and not name.startswith("service.safety")}
    assert not foreign


@pytest.mark.parametrize("module", sorted((ROOT / "service/safety").glob("*.py")), ids=lambda path: path.stem)
def test_safety_calls_nothing_that_reads_or_writes_the_outside(module: Path) -> None:
    called = {
        node.func.id
        for node in ast.walk(ast.parse(module.read_text()))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    }
    assert not called & {"open", "print", "input", "exec", "eval", "__import__"}


def test_no_file_or_folder_is_a_junk_drawer() -> None:
    junk = {"utils", "util", "helpers", "helper", "common", "misc", "manager", "core"}
    drawers = [
        path for path in (*MODULES, *EXAMPLES, *TESTS) if junk & {part.removesuffix(".py") for part in path.parts[-3:]}
    ]
    assert not drawers


def test_no_docstring_begins_without_its_subject() -> None:
    headless = re.compile(r'"""(Of|What|Whether) ')
    sources = [path for path in MODULES if headless.search(path.read_text())]
    assert not sources, "say what the thing is or does"


def _names(node: ast.AST | None) -> set[str]:
    """Return the last part of every name in an expression."""
    found = (getattr(part, "attr", getattr(part, "id", None)) for part in ast.walk(node)) if node is not None else ()
    return {name for name in found if isinstance(name, str)}


def _losses_of_a_cancellation(source: Path) -> list[int]:
    """Return the lines in which a cancellation can be lost."""
    lines: list[int] = []
    for node in ast.walk(ast.parse(source.read_text())):
        if isinstance(node, ast.Attribute) and node.attr == "wait_for" and _names(node.value) == {"asyncio"}:
            lines.append(node.lineno)
        elif isinstance(node, ast.ImportFrom) and node.module == "asyncio":
            lines += [node.lineno for alias in node.names if alias.name == "wait_for"]
        elif isinstance(node, ast.Call) and _names(node.func) & {"suppress"}:
            caught = set().union(*map(_names, node.args))
            lines += [node.lineno] if caught & {"CancelledError", "BaseException"} else []
        elif isinstance(node, ast.ExceptHandler):
            catches = node.type is None or _names(node.type) & {"CancelledError", "BaseException"}
            passes_on = any(isinstance(part, ast.Raise) for part in ast.walk(node))
            lines += [node.lineno] if catches and not passes_on else []
    return lines


def test_77_no_cancellation_is_lost() -> None:
    """`asyncio.wait_for` of Python 3.11 loses one that comes with the result; `asyncio.timeout` does not."""
    found = {
        str(path.relative_to(ROOT)): lines
        for path in (*MODULES, *EXAMPLES)
        if (lines := _losses_of_a_cancellation(path))
    }
    assert not found


def test_no_module_is_too_long_to_read_in_one_sitting() -> None:
    lengths = {
        str(path.relative_to(ROOT)): len(path.read_text().splitlines()) for path in (*MODULES, *EXAMPLES, *TESTS)
    }
    assert not {name: length for name, length in lengths.items() if length > 450}


def test_nothing_of_ours_bears_the_name_of_a_certified_function() -> None:
    claim = re.compile(r"\be-?stop\b|\bemergency[ _-]stop", re.IGNORECASE)
    # What stands for the vendor's robot, and speaks of the stops that it has itself, keeps their names.
    robot = (
        "sim_backend/ur_controller/",
        "wire/primary",
        "service/drivers/ur/",
        "docs/how-to/commission-a-ur.md",
    )
    modules = [path for path in MODULES if not str(path.relative_to(ROOT)).startswith(robot)]
    documents = [path for path in DOCUMENTS if not str(path.relative_to(ROOT)).startswith(robot)]
    named = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in (*modules, *EXAMPLES, *documents, *(ROOT / "api").rglob("*.html"), *(ROOT / "api").rglob("*.js"))
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if claim.search(line) and not re.search(r"\bnot\b|\bno\b|\bnever\b|robot's own|\bUR\b", line)
    ]
    assert not named


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_document_links_lead_somewhere(document: Path) -> None:
    targets = [a or b for a, b in LINK.findall(document.read_text())]
    inside = [t.split("#")[0] for t in targets if not re.match(r"[a-z]+:|#", t)]
    assert not [target for target in inside if not (document.parent / target).exists()]


def test_document_of_decisions_lists_every_record_in_order() -> None:
    folder = ROOT / "docs/explanation/decisions"
    records = sorted(path.name for path in folder.glob("0*.md"))
    assert re.findall(r"\((0[^)]+\.md)\)", (folder / "README.md").read_text()) == records
    assert [int(name[:4]) for name in records] == list(range(1, len(records) + 1))


def test_document_of_faults_has_every_code() -> None:
    text = (ROOT / "docs/reference/faults.md").read_text()
    assert not [code.value for code in FaultCode if f"`{code.value}`" not in text]


def test_constraints_pin_every_dependency_to_a_version_that_is_allowed() -> None:
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if line and line[0] != "#"]
    pins = dict(line.split("==") for line in lines)
    pins = {re.sub(r"[-_.]+", "-", name).lower(): version for name, version in pins.items()}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    declared = [Requirement(text) for text in sum(project["optional-dependencies"].values(), project["dependencies"])]
    versions = {need: pins.get(need.name.replace("_", "-").lower(), "no pin") for need in declared}
    assert "no pin" not in versions.values()
    assert not [f"{need}: {pin}" for need, pin in versions.items() if not need.specifier.contains(pin)]
