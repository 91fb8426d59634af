"""Ten insertions over HTTP: a client that starts each run, follows it to its end and prints a table.

    dsl-assembly serve                    # in another terminal, or `make run`
    python examples/ten_insertions.py --recipe triangle-2mm --count 10

Exit status: 0 every peg is in; 1 a run failed; 2 the cell cannot go on (latched, a start refused, no answer).
"""

import argparse
import json
import sys
import time
import uuid
from http import HTTPStatus
from typing import Any

import httpx

RUN_S = 120.0
ROW = "{:>4}  {:<20}{:>8}{:>12}{:>7}{:>8}".format


class CellError(Exception):
    """The cell cannot go on; the text says what to do."""


def start(http: httpx.Client, recipe: str, seed: int) -> str:
    """Start a run and return its id."""
    # After a lost answer the request may be repeated with the same key: the cell starts nothing twice.
    key = {"Idempotency-Key": str(uuid.uuid4())}
    answer = http.post("/start", json={"recipe": recipe, "seed": seed}, headers=key)
    if answer.status_code != HTTPStatus.ACCEPTED:
        problem = answer.json()  # RFC 9457: `reason` for programs, `detail` for people
        raise CellError(f"start refused, {problem['reason']}: {problem['detail']}")
    return answer.json()["id"]


def follow(http: httpx.Client, run_id: str) -> dict[str, Any]:
    """Read the event stream until this run has ended and the arm stands; return the last status."""
    deadline = time.monotonic() + RUN_S
    with http.stream("GET", "/events") as stream:  # a status four times a second, and the lines of the journal
        for line in stream.iter_lines():
            told: dict[str, Any] = json.loads(line.removeprefix("data: ")) if line.startswith("data: ") else {}
            if "can_start" not in told:
                continue  # no status
            run: dict[str, Any] = told["run"] or {}
            if run.get("id") == run_id and run["state"] != "ACTIVE" and told["state"] in ("READY", "LATCHED"):
                return told
            if time.monotonic() > deadline:  # UNKNOWN: the cell is silent
                raise CellError(f"no end of {run_id} in {RUN_S:g} s; the cell is {told['state']}: {told['why_not']}")
    raise CellError("the event stream ended: does the API still run?")


def refuse_latched(status: dict[str, Any]) -> None:
    """Leave a latched cell to a person: only someone who has looked at it may reset it."""
    if (latch := status["latch"]) is not None:
        way = "Inspect it, then acknowledge on the operator's page or by POST /reset."
        raise CellError(f"the cell is LATCHED by {latch['code']} ({latch['text']}). {way}")


def insert(http: httpx.Client, recipe: str, count: int) -> int:
    """Run the insertions; return how many pegs went in."""
    refuse_latched(http.get("/status").raise_for_status().json())
    print(ROW("seed", "outcome", "depth", "peak force", "steps", "time"), flush=True)
    inserted = 0
    for seed in range(count):
        run_id = start(http, recipe, seed)
        status = follow(http, run_id)
        run = http.get(f"/runs/{run_id}").raise_for_status().json()  # the record, with its final figures
        inserted += run["state"] == "SUCCEEDED"
        depth = "–" if run["depth_m"] is None else f"{run['depth_m'] * 1e3:.1f} mm"
        force, seconds = f"{run['peak_force_n']:.1f} N", f"{run['duration_s']:.1f} s"
        print(ROW(seed, run["code"] or run["state"], depth, force, run["steps"], seconds), flush=True)
        refuse_latched(status)
    return inserted


def main() -> int:
    """Read the arguments, run, report."""
    options = argparse.ArgumentParser(description="Run insertions on a cell and print a table.")
    options.add_argument("--url", default="http://127.0.0.1:8000")
    options.add_argument("--recipe", default="triangle-2mm")
    options.add_argument("--count", type=int, default=10)
    asked = options.parse_args()
    try:
        with httpx.Client(base_url=asked.url, timeout=15, trust_env=False) as http:
            inserted = insert(http, asked.recipe, asked.count)
    except (CellError, httpx.HTTPError) as error:
        print(f"stopped: {error}", file=sys.stderr)
        return 2
    print(f"{inserted} of {asked.count} pegs are in")
    return 0 if inserted == asked.count else 1


if __name__ == "__main__":
    sys.exit(main())
