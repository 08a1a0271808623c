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
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.changed import before, changed
from tests.mutations.copies import copy_of_the_checkout, environment
from tests.mutations.faults import Fault, faults
from tests.mutations.random_run import random_run
from tests.mutations.reach import product_files

LIMIT_S = 600.0


def passes(folder: Path, tests: tuple[str, ...]) -> bool:
    """Whether the tests pass in the copy, whose packages come before the installed ones."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests],
        cwd=folder, env=environment(folder),
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=LIMIT_S, text=True,
    )  # fmt: skip
    if done.returncode not in (0, 1):
        raise SystemExit(f"pytest ended with status {done.returncode}:\n{done.stdout}")
    return done.returncode == 0


def survives(folder: Path, fault: Fault) -> bool:
    """Whether the tests of a fault pass though it is in."""
    file = folder / fault.file
    sound = file.read_text()
    file.write_text(fault.put_into(sound))
    try:
        return passes(folder, fault.tests)
    finally:
        file.write_text(sound)


def known_faults(words: list[str]) -> int:
    """Try the faults of the table and print one line each; return 1 if one survives."""
    chosen = [f for f in faults() if not words or any(word in f.name for word in words)]
    if not chosen:
        raise SystemExit(f"no fault is called like {' or '.join(words)}")
    with tempfile.TemporaryDirectory() as name:
        folder = copy_of_the_checkout(Path(name, "checkout"))
        sound = tuple(dict.fromkeys(test for fault in chosen for test in fault.tests))
        if not passes(folder, sound):
            raise SystemExit("the tests fail without any fault: mend them first")
        alive = []
        for n, fault in enumerate(chosen, start=1):
            lives = survives(folder, fault)
            print(f"{n}/{len(chosen)} {'SURVIVED' if lives else 'killed  '} {fault.name}", flush=True)
            alive += [fault.name] * lives
    print(f"{len(chosen) - len(alive)} of {len(chosen)} faults killed")
    return 1 if alive else 0


def main(words: list[str]) -> int:
    """Try known faults, or random ones."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutations", description="Put faults in and see the tests fail.")
    parser.add_argument("words", nargs="*", help="faults whose name, or place and change, contains one of the words")
    parser.add_argument("--random", type=int, metavar="NUMBER", help="random faults, instead of the known ones")
    parser.add_argument("--seed", type=int, default=1, help="of the random faults")
    parser.add_argument("--changed", action="store_true", help="random faults in files that a change touches, by own tests")
    parser.add_argument("--since", metavar="REVISION", help="where the change began; else where it left main")
    parser.add_argument("--seconds", type=float, default=math.inf, help="after which random faults are ended")
    parser.add_argument("--fresh", action="store_true", help="measure again what each test reaches")
    parser.add_argument("-n", type=int, default=0, metavar="WORKERS", help="processes that do it")
    given = parser.parse_args(words)
    if given.random is None:
        return known_faults(given.words)
    return random_run(given.random, given.seed, given.words, own=of_the_change(given.since) if given.changed else None,
                      limit_s=given.seconds, fresh=given.fresh, workers=given.n)  # fmt: skip


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
