"""Put known faults into a copy of the checkout, one at a time, and see the tests named for each fail.

    python -m tests.mutations                  # all of faults.toml
    python -m tests.mutations pipe trip        # those whose name contains one of the words

A fault that its tests do not see is a hole in the tests: status 1 names it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.mutations.faults import ROOT, Fault, faults

LIMIT_S = 600.0


def copy_of_the_checkout(folder: Path) -> Path:
    """Copy what git knows of the checkout, uncommitted changes included."""
    names = subprocess.run(["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True, check=True)
    for name in names.stdout.splitlines():
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


def passes(folder: Path, tests: tuple[str, ...]) -> bool:
    """Whether the tests pass in the copy, whose packages come before the installed ones."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests],
        cwd=folder, env={**os.environ, "PYTHONPATH": str(folder), "OMP_NUM_THREADS": "1"},
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


def main(words: list[str]) -> int:
    """Try the faults and print one line each; return 1 if one survives."""
    chosen = [f for f in faults() if not words or any(word in f.name for word in words)]
    if not chosen:
        raise SystemExit(f"no fault is called like {' or '.join(words)}")
    with tempfile.TemporaryDirectory() as name:
        folder = copy_of_the_checkout(Path(name))
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


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
