"""Coverage-guided fuzzing of one function that takes bytes; for programs that `test_fuzz.py` starts."""

import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import atheris

MEMORY_MB = 512


def fuzz(check: Callable[[bytes], None], seeds: Iterable[bytes]) -> None:
    """Run `check` on what grows out of `seeds` until the time is over; does not return.

    An exception, an input that hangs or one that takes more memory than `MEMORY_MB` ends the process with another
    status than 0. Command line: a folder for corpus and findings, seconds, seconds of wall clock after which an input
    hangs.
    """
    folder, seconds, hang_s = Path(sys.argv[1]), sys.argv[2], sys.argv[3]
    corpus = folder / "corpus"
    corpus.mkdir()
    for number, seed in enumerate(seeds):
        (corpus / f"seed-{number}").write_bytes(seed)
    options = [f"-max_total_time={seconds}", f"-timeout={hang_s}", f"-rss_limit_mb={MEMORY_MB}"]
    atheris.Setup([sys.argv[0], str(corpus), f"-artifact_prefix={folder}/", "-max_len=4096", *options], check)
    atheris.Fuzz()
