"""Put known faults into a copy of the checkout, one at a time, and see the tests named for each fail.

    python -m tests.mutations                  # all of faults.toml
    python -m tests.mutations pipe trip        # those whose name contains one of the words
    python -m tests.mutations --random 300     # random ones in all rooms, judged by the tests that reach them
    python -m tests.mutations --random 30 --changed    # in the files that a change touches, judged by their own tests

A known fault that its tests do not see is a hole in the tests: status 1 names it. Of random ones a share must be seen.
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

from tests.changed import before, changed
from tests.mutations.copies import copy_of_the_checkout, environment
from tests.mutations.faults import faults
from tests.mutations.judge import Judge, at_once
from tests.mutations.random_run import random_run
from tests.mutations.reach import product_files


def known_faults(words: list[str], workers: int) -> int:
    """Try the faults of the table and print one line each; return 1 if one survives."""
    chosen = [f for f in faults() if not words or any(word in f.name for word in words)]
    if not chosen:
        raise SystemExit(f"no fault is called like {' or '.join(words)}")
    sound_ones_pass({test: None for fault in chosen for test in fault.tests}, workers)
    alive = []
    for n, (fault, seen) in enumerate(at_once(chosen, Judge.sees, workers), start=1):
        print(f"{n}/{len(chosen)} {'killed  ' if seen else 'SURVIVED'} {fault.name}", flush=True)
        alive += [fault.name] * (not seen)
    print("\n".join([f"{len(chosen) - len(alive)} of {len(chosen)} faults killed", *alive]))
    return 1 if alive else 0


def sound_ones_pass(tests: Iterable[str], workers: int) -> None:
    """Run tests without any fault: what fails anyway shows nothing."""
    with tempfile.TemporaryDirectory() as name:
        folder = copy_of_the_checkout(Path(name, "checkout"))
        words = ["-q", "-n", str(workers), "--dist", "worksteal", "-p", "no:cacheprovider", *tests]
        done = subprocess.run([sys.executable, "-m", "pytest", *words], cwd=folder, env=environment(folder), capture_output=True,
                              text=True)  # fmt: skip
    if done.returncode:
        raise SystemExit(f"the tests fail without any fault: mend them first\n{done.stdout}")


def main(words: list[str]) -> int:
    """Try known faults, or random ones."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutations", description="Put faults in and see the tests fail.")
    parser.add_argument("words", nargs="*", help="faults whose name, or place and change, contains one of the words")
    parser.add_argument("--random", type=int, metavar="NUMBER", help="random faults, instead of the known ones")
    parser.add_argument("--seed", type=int, default=1, help="of the random faults")
    parser.add_argument("--changed", action="store_true", help="random faults in files that a change touches, by own tests")
    parser.add_argument("--since", metavar="REVISION", help="where the change began; else where it left main")
    parser.add_argument("--seconds", type=float, default=math.inf, help="after which random faults are ended")
    parser.add_argument("--decide", action="store_true", help="begin no random fault where the run cannot fail any more")
    parser.add_argument("--fresh", action="store_true", help="measure again what each test reaches")
    parser.add_argument("-n", type=int, default=os.cpu_count(), metavar="WORKERS", help="processes that do it")
    given = parser.parse_args(words)
    if given.random is None:
        return known_faults(given.words, given.n)
    return random_run(given.random, given.seed, given.words, own=of_the_change(given.since) if given.changed else None,
                      limit_s=given.seconds, fresh=given.fresh, workers=given.n, decide=given.decide)  # fmt: skip


def of_the_change(since: str | None) -> list[str]:
    """Return the product files that a change touches, all where git does not know when it began; print which."""
    since, files = since or before(), product_files()
    if since is None:
        print("git has no earlier commit here (a shallow clone): faults in all files")
        return files
    touched = {*changed(since=since)}
    files = [file for file in files if file in touched]
    print(f"faults in {len(files)} files that differ from {since}")
    return files


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
