"""Files that a command writes: whole or not at all, never through somebody's link, never over somebody's file unasked."""

from __future__ import annotations

import errno
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hil.errors import HilError


@contextmanager
def written_whole(target: Path, *, replace: bool) -> Iterator[Path]:
    """Give a new, empty file beside the target to write to, and put it in the target's place when all went well.

    The new file's name is drawn at random and the file is created exclusively, so that nobody can have put a link there. It
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
