"""One matrix of real numbers from a MATLAB file, read by scipy in a process of its own, under limits."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Final

from hil.errors import HilError

_CHILD: Final = Path(__file__).with_name("mat_child.py")


def npy_of_mat(data: bytes, key: str, most_numbers: int) -> bytes:
    """Return a matrix of a MATLAB file, version 4 to 7, in numpy's format `.npy`; see `hil.files.mat_child`.

    Args:
        data: the file.
        key: name of the variable.
        most_numbers: the most that it may hold.

    Raises:
        HilError: the file is damaged, of another version, or holds no such matrix.
    """
    done = subprocess.run(
        [sys.executable, "-I", str(_CHILD), key, str(most_numbers)],  # -I: no folder of the user is on its path
        input=data, capture_output=True, env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    if done.returncode < 0:
        raise HilError(f"is no whole .mat file: scipy's reader ended by {signal.Signals(-done.returncode).name}")
    if done.returncode != 0:
        raise HilError(done.stderr.decode(errors="replace").strip()[-500:])
    return done.stdout
