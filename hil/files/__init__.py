"""Users' files, read and written: regular and of bounded size, whole or not at all; keys, signatures, arrays, TOML.

Here is the one place in which a file of the user's is opened: regular, of bounded size, never waited for. The places of files
that a command writes are checked before the work; they never go through a symbolic link, and never over a file unasked.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from hil.errors import HilError, located


def read_regular(path: str | Path, most_bytes: int, what: str) -> bytes:
    """Return the bytes of a regular file; see `open_regular`.

    Args:
        path: the file.
        most_bytes: the most that it may have.
        what: what it should be, for the message, with its article ("an experiment file").

    Raises:
        HilError: it cannot be read, is a folder, a pipe or a device, or has more bytes.
    """
    with open_regular(path, what) as file, located(f"{path}: cannot be read", OSError):
        data = file.read(most_bytes + 1)
    if len(data) > most_bytes:
        raise HilError(f"{path}: more than {most_bytes} bytes, the limit of {what}")
    return data


@contextmanager
def open_regular(
    path: str | Path, what: str, *, follow: bool = True, descriptor: int | None = None, buffering: int = -1
) -> Iterator[BinaryIO]:  # fmt: skip
    """Open a regular file for reading.

    The type is asked of the open file, so that no pipe can be put in its place between the question and the reading; it
    is opened without waiting, as a pipe without a writer would be waited for without end.

    Args:
        path: the file.
        what: what it should be, for the message, with its article.
        follow: whether the path may be a symbolic link.
        descriptor: the file, open already (its name may be gone); it stays open, and is read from its beginning.
        buffering: bytes, see `open`.

    Raises:
        HilError: it cannot be opened, or is a folder, a pipe or a device.
    """
    flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | (0 if follow else os.O_NOFOLLOW)
    try:
        own = os.open(path, flags) if descriptor is None else os.dup(descriptor)
    except (OSError, ValueError) as e:  # ValueError: a name with a zero byte
        raise HilError(f"{path}: cannot be read: {getattr(e, 'strerror', None) or e}") from e
    try:
        refuse_irregular(path, os.fstat(own).st_mode, what)
        with open(own, "rb", buffering=buffering, closefd=False) as file:
            file.seek(0)
            yield file
    finally:
        os.close(own)


def refuse_irregular(path: str | Path, mode: int, what: str) -> None:
    """Refuse what is no regular file: a device has no end, and a pipe may have no beginning.

    Args:
        path: for the message.
        mode: `st_mode` of the file.
        what: what it should be, with its article.

    Raises:
        HilError: it is no regular file.
    """
    if not stat.S_ISREG(mode):
        raise HilError(f"{path}: is {'a folder' if stat.S_ISDIR(mode) else 'no regular file'}, not {what}")


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
    part = target.with_name(f".hil-{os.urandom(6).hex()}.part{target.suffix[:16]}")
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
    """Make files that are not there yet, all of them or none, and return their paths.

    Raises:
        OSError: one is there, or cannot be written.
    """
    made: list[Path] = []
    try:
        for path, data, mode in files:
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, mode)
            made.append(path)
            with open(descriptor, "wb") as file:
                file.write(data)
    except BaseException:
        for path in made:
            path.unlink(missing_ok=True)
        raise
    return made


PAGE = b"<!doctype html"  # as our pages begin


REMEDY = "choose another name or add --force"


def check_ending(path: Path, what: str, *endings: str) -> None:
    """Refuse a name that says another kind of file; a folder and a device, which have no ending, are refused elsewhere.

    Args:
        path: file to be written.
        what: what is written, with its article, for the message.
        endings: those that the name may have; none: any.

    Raises:
        HilError: the name has another ending.
    """
    if endings and path.suffix.lower() not in endings and (os.path.isfile(path) or not os.path.lexists(path)):
        raise HilError(f"{path}: {what} is written here; expected a name that ends in {' or '.join(endings)}")


def check_output(
    path: Path | None, what: str = "a file", *endings: str, force: bool = False, page: bool = False, remedy: str = REMEDY
) -> None:  # fmt: skip
    """Refuse a path at which no file can be written, before the work.

    Args:
        path: file to be written; None where none is asked for.
        what, endings: as in `check_ending`.
        force: whether a file that is already there may be replaced.
        page: whether a page may, and no other file.
        remedy: what the message about such a file advises.

    Raises:
        HilError: if it has another ending, is a folder or a device, exists already (see above), or its folder is missing or
            cannot be written.
    """
    import tempfile  # what only reads needs none

    if path is None:
        return
    check_ending(path, what, *endings)
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
    if found and not (force or page):
        raise HilError(f"{path}: exists already; {remedy}")
    if not target.parent.is_dir():
        raise HilError(f"{path}: cannot be written: no folder {target.parent if found else path.parent}")
    with located(f"{path}: cannot be written", OSError):
        if target.exists():
            with open(target, "r+b") as file:  # nothing is written, but it could be
                if page and file.read(len(PAGE)).lower() != PAGE:
                    raise HilError(f"{path}: exists already and is no report; {remedy}")
        with tempfile.TemporaryFile(dir=target.parent):  # root has permission everywhere, and still cannot write in /proc
            pass


def check_page(path: Path | None, *, force: bool = False, remedy: str = REMEDY) -> None:
    """Refuse a path at which no page can be written; one of ours that is there is replaced.

    Args:
        path: file to be written; None where none is asked for.
        force: replace also a file that is no page.
        remedy: what the message about such a file advises.

    Raises:
        HilError: if it is not named as a page is, and as `check_output`.
    """
    check_output(path, "a page", ".html", ".htm", force=force, page=not force, remedy=remedy)


def made_folder(folder: Path) -> Path:
    """Make a folder and those above it, where they are not there; return it.

    Raises:
        HilError: it cannot be made.
    """
    with located(f"{folder}: cannot be made", OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def write_output(path: Path, text: str, *, replace: bool = True) -> None:
    """Write a file in one step: there is the old file or the new one, never half of it.

    Args:
        path: the file; a symbolic link is followed.
        text: its content; half characters, which no file can hold, are escaped.
        replace: whether one that is there may be replaced; `check_output` has looked before the work, this looks again.

    Raises:
        HilError: if it cannot be written, or is there and is no regular file.
    """
    with written_whole(_target(path), replace=replace) as part, open(part, "w", encoding="utf-8") as file:
        file.write(text.encode("utf-8", "backslashreplace").decode())


def _target(path: Path) -> Path:
    """Where a symbolic link leads to."""
    return Path(os.path.realpath(path))
