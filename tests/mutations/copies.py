"""A copy of the checkout, into which faults are put, and what a test that runs there finds in its environment."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from tests.mutations.faults import ROOT


def copy_of_the_checkout(folder: Path) -> Path:
    """Copy what git knows of the checkout, uncommitted changes included."""
    names = subprocess.run(["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True, check=True)
    for name in names.stdout.splitlines():
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


def environment(folder: Path) -> dict[str, str]:
    """Return the environment of tests of a copy: its own packages first, no options of the pytest that runs outside, bytecode
    that is kept for the next run, and a temporary folder of its own beside the copy: a fault may remove what it finds there.
    """
    temporary = folder.parent / "tmp"
    temporary.mkdir(exist_ok=True)
    own = {"PYTHONPATH": str(folder), "TMPDIR": str(temporary), "OMP_NUM_THREADS": "1"}
    own |= {"PYTEST_ADDOPTS": "", "PYTHONDONTWRITEBYTECODE": ""}
    return {**os.environ, **own}
