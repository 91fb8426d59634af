"""Lives through many seeds: `python -m tests.simulation --seeds 10000`. One seed with its story: `--seed 17`."""

import argparse
import sys
import time

from tests.simulation.seeds import live_through
from tests.simulation.story import tell


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.simulation", description=__doc__)
    parser.add_argument("--seeds", type=int, default=500, help="number of seeds")
    parser.add_argument("--first", type=int, default=0, help="first of them")
    parser.add_argument("--workers", type=int, default=None, help="processes; one per core by default")
    parser.add_argument("--seed", type=int, help="tell the story of this seed alone")
    asked = parser.parse_args()
    if asked.seed is not None:
        outcome = tell(asked.seed)
        print(f"# {outcome.plan.surroundings}, policy {outcome.plan.policy}, sensor {outcome.plan.lie}")
        for at_s, text in outcome.trace:
            print(f"{at_s:.6f} {text}")
        print(f"# trace {outcome.digest}, violations: {'; '.join(outcome.violations) or 'none'}")
        return bool(outcome.violations)
    began_s = time.perf_counter()
    report = live_through(range(asked.first, asked.first + asked.seeds), asked.workers, progress=sys.stderr.isatty())
    print(report.text(time.perf_counter() - began_s))
    return bool(report.failed)


if __name__ == "__main__":
    raise SystemExit(main())
