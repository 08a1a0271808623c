"""Other code than this checkout's, measured beside it: the loop compiled, and an older version.

Either is a folder that stands on Python's path before the checkout; the environment of the checkout serves all of them.
"""

from __future__ import annotations

import filecmp
import os
import subprocess
from pathlib import Path
from typing import Final

from hil.errors import HilError
from hil.runtime.real.child import PYTHON

CHECKOUT: Final = Path(__file__).parents[2]
BEFORE: Final = "HILRIG_BENCH_BEFORE"
"""Names the folder of the older version to the processes that measure."""

OLD: Final = "3aeb887"
"""The commit that a slot is set beside."""

_ASK: Final = "from hil.log.write.provenance import loop_form; print(loop_form())"


def beside(folder: Path) -> dict[str, str]:
    """Return the changes of the environment with which Python finds packages in a folder first."""
    return {"PYTHONPATH": str(folder.resolve())}


def check_compiled(folder: Path) -> None:
    """Return if a folder has the packages of this checkout with their loop compiled.

    Raises:
        HilError: it has not, or its files are not those of the checkout.
    """
    asked = subprocess.run([*PYTHON, "-c", _ASK], capture_output=True, text=True, env=os.environ | beside(folder))
    if asked.stdout.strip() != "compiled" or not (folder / "hil").is_dir():
        raise HilError(f"--compiled {folder}: expected a wheel with the compiled loop, unpacked (make compiled)")
    for package in ("hil", "plants", "transport", "design"):
        for path in (folder / package).rglob("*.py"):
            own = CHECKOUT / path.relative_to(folder)
            if not own.is_file() or not filecmp.cmp(path, own, shallow=False):
                raise HilError(f"--compiled {folder}: {own.relative_to(CHECKOUT)} is another file in the checkout; make compiled")


def check_before(folder: Path) -> None:
    """Return if a folder has packages of ours.

    Raises:
        HilError: it has not.
    """
    if not (folder / "hil" / "bench" / "engines.py").is_file():
        raise HilError(f"--before {folder}: expected the sources of {OLD}: git archive {OLD} | tar -x -C FOLDER")
