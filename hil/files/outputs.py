"""Files that a command writes: their places checked before the work, written whole or not at all.

They never go through a symbolic link, and never over a file unasked.
"""

from __future__ import annotations

import errno
import os
import secrets
import stat
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from hil.errors import HilError

File = tuple[Path, bytes, int]
"""Path, contents, mode."""


@contextmanager
def written_whole(target: Path, *, replace: bool) -> Iterator[Path]:
    """Give a new, empty file beside the target to write to, and put it in the target's place when all went well.

    The new file's name is drawn at random and the file is created exclusively, so that no link can stand there. It
    keeps the target's ending, by which some writers choose their format.

    Args:
        target: the file to make; a symbolic link is replaced, not followed, and anything else that is no file stays.
        replace: whether a file that is there may be replaced. Otherwise one that has come since the command looked is kept.

    Raises:
        HilError: it exists (without `replace`), is no regular file, or cannot be written; nothing is left behind.
    """
    if "\0" in str(target):  # a topic of a log names a file of its export
        raise HilError(f"{target}: cannot be written: a name with a zero byte")
    part = target.with_name(f".hil-{secrets.token_hex(6)}.part{target.suffix[:16]}")
    try:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        os.close(os.open(part, flags, 0o666))
        yield part
        with suppress(FileNotFoundError):
            mode = target.lstat().st_mode
            if not stat.S_ISREG(mode) and not stat.S_ISLNK(mode):  # root could put a file in the place of a device
                raise HilError(f"{target}: cannot be written: it is no regular file")
        if replace:
            part.replace(target)
        else:
            _put(part, target)
    except FileExistsError:
        raise HilError(f"{target}: exists already; choose another name, or add --force") from None
    except OSError as error:
        raise HilError(f"{target}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def _put(part: Path, target: Path) -> None:
    try:
        os.link(part, target)
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.EOPNOTSUPP, errno.EMLINK):
            raise
        # A file system without hard links, such as that of a memory stick: the name is taken first.
        os.close(os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666))
        part.replace(target)


def new_files(files: Sequence[File]) -> list[Path]:
    """Make files that are not there yet, and return their paths.

    Raises:
        OSError: one is there, or cannot be written.
    """
    for path, data, mode in files:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, mode)
        with open(descriptor, "wb") as file:
            file.write(data)
    return [path for path, _, _ in files]


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
        raise HilError(f"{path}: cannot be written: {e.strerror or e}") from e
    return path


PAGES = (".html", ".htm")


def check_page(path: Path, *, force: bool = False, remedy: str = "choose another -o or add --force") -> Path:
    """Return ``path`` if a page can be written there; one of ours that is there is replaced.

    Args:
        path: file to be written.
        force: replace also a file that is no page.
        remedy: what the message about such a file advises.

    Raises:
        HilError: if it is not named as a page is, and as `check_output`.
    """
    if path.suffix.lower() not in PAGES and not os.path.isdir(path):
        raise HilError(f"{path}: a page is written here; expected a name that ends in .html")
    return check_output(path, page=not force, remedy=remedy)


def made_folder(folder: Path) -> Path:
    """Make a folder and those above it, where they are not there; return it.

    Raises:
        HilError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise HilError(f"{folder}: cannot be made: {error.strerror or error}") from error
    return folder


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
