"""Places to write to, checked before the work is done whose result goes there, and written in one step."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from hil.errors import HilError
from hil.files.exclusive import written_whole

PAGE = b"<!doctype html"  # as our pages begin


def check_output(path: Path, *, fresh: bool = False, page: bool = False, remedy: str = "choose another -o") -> Path:
    """Return ``path`` if a file can be written there.

    Args:
        path: file to be written.
        fresh: refuse a file that is already there.
        page: refuse a file that is already there and is no page.
        remedy: what the message about such a file advises.

    Raises:
        HilError: if it is a folder or a device, exists already (see above), or its folder is missing or cannot be written.
    """
    try:
        path.lstat()
        found = True
    except FileNotFoundError:
        found = False
    except OSError as e:  # name too long, a file where a folder should be, ...
        raise HilError(f"{path}: cannot be written: {e.strerror}") from e
    target = _target(path)
    if target.is_dir():
        raise HilError(f"{path}: cannot be written: it is a folder")
    if target.exists() and not target.is_file():
        raise HilError(f"{path}: cannot be written: it is no regular file")
    if found and fresh:
        raise HilError(f"{path}: exists already; {remedy}")
    if not target.parent.is_dir():
        raise HilError(f"{path}: cannot be written: no folder {target.parent if found else path.parent}")
    try:
        if target.exists():
            with open(target, "r+b") as file:  # nothing is written, but it could be
                if page and file.read(len(PAGE)).lower() != PAGE:
                    raise HilError(f"{path}: exists already and is no report; {remedy}")
        with tempfile.TemporaryFile(dir=target.parent):  # root has permission everywhere, and still cannot write in /proc
            pass
    except OSError as e:
        raise HilError(f"{path}: cannot be written: {(e.strerror or str(e)).lower()}") from e
    return path


def write_output(path: Path, text: str, *, replace: bool = True) -> None:
    """Write a file in one step: there is the old file or the new one, never half of it.

    Args:
        path: the file; a symbolic link is followed.
        text: its content.
        replace: whether one that is there may be replaced; `check_output` has looked before the work, this looks again.

    Raises:
        HilError: if it cannot be written, or is there and is no regular file.
    """
    with written_whole(_target(path), replace=replace) as part, open(part, "w", encoding="utf-8") as file:
        file.write(text)


def _target(path: Path) -> Path:
    """Where a symbolic link leads to."""
    return Path(os.path.realpath(path))
