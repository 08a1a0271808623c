"""Places to write to, checked before the work is done whose result goes there."""

from __future__ import annotations

import os
from pathlib import Path

from hil.errors import HilError


def check_output(path: Path, *, fresh: bool = False) -> Path:
    """Return ``path`` if a file can be written there.

    Parameters
    ----------
    path : Path
        File to be written.
    fresh : bool
        Refuse a file that is already there.

    Raises
    ------
    HilError
        If it is a folder, exists already (with ``fresh``), or its folder is missing or cannot be written.
    """
    try:
        path.lstat()
        found = True
    except FileNotFoundError:
        found = False
    except OSError as e:  # name too long, a file where a folder should be, ...
        raise HilError(f"{path}: cannot be written: {e.strerror}") from e
    if path.is_dir():
        raise HilError(f"{path}: cannot be written: is a folder")
    if found and fresh:
        raise HilError(f"{path}: exists already; choose another -o")
    if not path.parent.is_dir():
        raise HilError(f"{path}: cannot be written: there is no folder {path.parent}")
    if not os.access(path if found else path.parent, os.W_OK):
        raise HilError(f"{path}: cannot be written: permission denied")
    return path
