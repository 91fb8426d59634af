"""Mutation testing of the safety core and of a cell's stop path: `python -m tests.mutation`.

mutmut changes one operator, constant or argument at a time, and runs the tests that reach it. A mutant that survives
must be explained by a rule of `EXPLAINED`; others fail the command.
"""

import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MUTMUT = (sys.executable, "-m", "mutmut")
MUTATED = ("service/safety/*.py", *(f"service/cell/{name}.py" for name in ("standstill", "arm_stops", "halting")))
TESTS = (
    "tests/service/safety",
    *(f"tests/service/cell/test_{name}.py" for name in ("arm_stops", "standstill", "latch", "stop_path")),
)
COPIED = ("api", "cli", "config", "models", "sim_backend", "training", "wire")
SURVIVED, NOT_REACHED = 0, 33
SETTINGS = f"""

[tool.mutmut]
source_paths = ["service"]
only_mutate = {json.dumps(MUTATED)}
also_copy = {json.dumps(COPIED)}
# a mutant may wait for ever: killed after three times the processor time of all its tests
timeout_multiplier = 1.5
pytest_add_cli_args = ["-p", "no:cacheprovider", "-p", "no:unraisableexception"]
pytest_add_cli_args_test_selection = {json.dumps(TESTS)}
"""


@dataclass(frozen=True)
class Rule:
    """A reason why a mutant may survive.

    Attributes:
        pattern: searched in "removed lines → added lines".
        where: searched in the mutant's name.
    """

    reason: str
    pattern: str
    where: str = ""


EXPLAINED = (
    Rule("a text for people", r"→.*XX|_newtons\(|→ text=None,$"),
    Rule("the value, limit and text of a verdict are for people; its code decides", r"Verdict\(|^[^=]*→ None,$|→ \)?$"),
    Rule("the same verdict with other numbers or another text for people", r"^(FaultCode\.\w+), .*→ \1, "),
    Rule("all rows are alike whichever they are compared with", r"window == window\[1\]"),
    Rule(
        "sequences that are zipped have equal lengths, as their types say",
        r"→ .*strict=(None|False)|strict=True.* → (?!.*strict=)",
    ),
    Rule("a unit in a text", r"\* 1001\.0"),
    Rule("a sum is finite only where every term is, whatever the signs", r"isfinite\(f[xyz]"),
    Rule("the default of an empty sequence, which no caller passes", r"default="),
    Rule("a peak that is met is the same peak", r"force >= self\._peak"),
    Rule(
        "callers pass arrays of the right type already",
        r"np\.(as)?array\(\w+, (None)?\)|np\.zeros\(.*(None|, )\)|ones_like\(None\)",
    ),
    Rule(
        "the first sample sets it, whatever it was",
        r"self\._(episode|seq|standing|repeats) = .*→",
        "reset",
    ),
    Rule("the first sample sets it, whatever it was", r"self\._(since|felt|equal)\b.* = (\[1\] \* 6|\[\]|0) →", "init"),
    Rule("nothing equals what is no number, however often it stands there", r"\[nan\] \* 6 →", "Repeats.*init"),
    Rule(
        "a damping ratio or a difference that meets its limit to the last bit",
        r"→ .*<= (FREE|CONTACT)_DAMPING_RATIO|→ .*apart <= self\._limit",
    ),
    Rule("a delay in a text", r"delay_s / 1e3"),
    Rule(
        "a leg sets it before it reads it",
        r"self\._(from_m|rest_n) = 0\.0 →",
        "Probe.*init",
    ),
    Rule(
        "a measured length or force that meets its limit to the last bit may fall on either side",
        r"→ .*(>= parameters\.width_m|> (parameters\.held_n|self\._parameters\.proven_m)|< (RETURNED_M|end_m)|"
        r"<= max\(self\._parameters\.lead_m)",
        "Probe",
    ),
    Rule(
        "a measured gain, angle, force or torque that meets its limit to the last bit may fall on either side",
        r"→ .*(<= MIN_GAIN|>= \(MAX_CROSSTALK|<= 0\.0\]|MAX_GAIN <(=?) (sizes\[row\]|gain) <(=?) MAX_GAIN|"
        r"< MAX_GAIN \* min|< self\.scale\.limit_n|(off|unlike) (<|>=) limit_nm|> MIN_TURN_RAD else)",
        "Weighing",
    ),
    Rule("all are equal if they are equal to any of them", r"window == window\[1\]"),
    Rule("a stop is repeated in every period, whatever its phase", r"STOP_AGAIN_TICKS == 1"),
    Rule("a run that is disengaged is there; its type says that it may be absent", r"active is None\) and False"),
    Rule(
        "at the boundary both branches give the same number",
        r"sine >= 1e-12|outside = distance >= radius|distance, radius\), 2\.0|1e-12\), 2\.0",
    ),
    Rule("a flag for people, at a limit that is met to the last bit", r"to_go_(m|rad) >= parameters"),
    Rule("an angle plus or minus half a turn, wrapped, is the same angle", r"- np\.pi, 2 \* np\.pi"),
    Rule("a bound beyond which nothing is a number of this cell", r"1e6|1000001\.0"),
    Rule(
        "a lower corner of None is no corner below the measured pose, which the leash keeps near",
        r"np\.clip\(position, None",
    ),
)


def main() -> int:
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder:
        place = Path(folder)
        _copy(place)
        done = subprocess.run([*MUTMUT, "run"], cwd=place, stdout=subprocess.DEVNULL)
        results = _results(place)
        if not results:
            print(f"mutmut ended with {done.returncode} and no result", file=sys.stderr)
            return 1
        survivors = {name: _difference(place, name) for name, code in results.items() if code == SURVIVED}
    reasons = {name: _reason(name, difference) for name, difference in survivors.items()}
    unexplained = [name for name, reason in reasons.items() if reason is None]
    for name in unexplained:
        print(f"{name}\n    {survivors[name]}")
    reached = [code for code in results.values() if code != NOT_REACHED]
    killed = sum(code != SURVIVED for code in reached)
    for reason, count in Counter(reason for reason in reasons.values() if reason is not None).most_common():
        print(f"{count} survive: {reason}")
    print(
        f"{len(results)} mutants, {len(results) - len(reached)} in code that these tests do not reach; "
        f"{killed} of {len(reached)} killed ({killed / len(reached):.1%}), {len(unexplained)} survivors unexplained"
    )
    return bool(unexplained)


def _copy(place: Path) -> None:
    for name in ("service", "tests", *COPIED):
        shutil.copytree(ROOT / name, place / name, ignore=shutil.ignore_patterns("__pycache__"))
    (place / "pyproject.toml").write_text((ROOT / "pyproject.toml").read_text() + SETTINGS)


def _results(place: Path) -> dict[str, int]:
    found: dict[str, int] = {}
    for path in (place / "mutants").rglob("*.py.meta"):
        found |= {
            name: code for name, code in json.loads(path.read_text())["exit_code_by_key"].items() if code is not None
        }
    return found


def _difference(place: Path, name: str) -> str:
    shown = subprocess.run([*MUTMUT, "show", name], cwd=place, capture_output=True, text=True).stdout
    lines = [line for line in shown.splitlines() if line[:1] in "+-" and not line.startswith(("+++", "---"))]
    removed = " ".join(line[1:].strip() for line in lines if line[0] == "-")
    added = " ".join(line[1:].strip() for line in lines if line[0] == "+")
    return f"{removed} → {added}"


def _reason(name: str, difference: str) -> str | None:
    removed, _, added = difference.partition(" → ")
    if removed.casefold() == added.casefold():
        return "a text for people"
    for rule in EXPLAINED:
        if re.search(rule.where, name) and re.search(rule.pattern, difference):
            return rule.reason
    return None


if __name__ == "__main__":
    raise SystemExit(main())
