"""What one user keeps from all others: directories, locks by which processes take turns, secrets, and roles on a link.

And the channels of the `hil` bus: folders of sockets, of which killed processes leave some that nothing listens at.
"""

from __future__ import annotations

import fcntl
import os
import select
import socket
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path
from typing import Final

from transport.links import Closing, Role, TransportError

_PAUSE_MS = 10
_TRIES = 100


@contextmanager
def locked(directory: Path, timeout_s: float) -> Iterator[None]:
    """Hold the lock on a directory in a private one, both made if missing; a killed holder's lock is void.

    The lock is the directory's own: a process that is stopped while it holds it bars this directory and no other.

    Args:
        directory: where processes meet. Where others may write, such as in /tmp, it and its parent must be ours already or
            not exist.
        timeout_s: how long to wait for the lock, s.

    Raises:
        TransportError: it or its parent belongs to another user, others may enter it, it is a symbolic link, there is no room
            for it, or the lock is not to be had.
    """
    os.close(_private(directory.parent))
    pause = select.poll()
    for _ in range(max(1, round(timeout_s / (_PAUSE_MS / 1000)))):
        descriptor = _private(directory)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_at(descriptor, directory):  # the last one to leave has not removed it while we opened it
                yield
                return
        except BlockingIOError:
            pause.poll(_PAUSE_MS)
        finally:
            os.close(descriptor)
    raise TransportError(
        f"{directory}: locked for {timeout_s:g} s by a process that is stopped while it joins; "
        "let it go on or end it, or choose another channel"
    )


def _private(directory: Path) -> int:
    """Open a directory that is ours alone, made if missing, and made again if another process clears it away in between."""
    for left in reversed(range(_TRIES)):
        try:
            directory.mkdir(mode=0o700, exist_ok=True)
            descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
            break
        except OSError as error:
            if not isinstance(error, FileNotFoundError) or not left:
                raise TransportError(f"{directory}: {error.strerror}") from error
    status = os.fstat(descriptor)
    if status.st_uid != os.geteuid() or stat.S_IMODE(status.st_mode) & 0o077:
        os.close(descriptor)
        need = f"must be a directory of user {os.geteuid()} with mode 700"
        raise TransportError(f"{directory}: {need}; chmod 700 it, or choose another directory")
    return descriptor


def private_directory(directory: Path) -> Path:
    """Return a directory that is ours alone (mode 700), made if missing.

    Args:
        directory: in a directory where others may write, such as /tmp, it must be ours already or not exist.

    Raises:
        TransportError: it belongs to another user, others may enter it, it is a symbolic link, or there is no room for it.
    """
    os.close(_private(directory))
    return directory


def _is_at(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), os.lstat(path))
    except FileNotFoundError:
        return False


MOST_BYTES = 65_536


def read_secret(path: str, what: str) -> bytes:
    """Return the bytes of a secret file; see `read_bounded`.

    Raises:
        TransportError: as there, or others than its owner may read or write it.
    """
    return read_bounded(path, what, secret=True)


def read_bounded(path: str | Path, what: str, most_bytes: int = MOST_BYTES, *, secret: bool = False) -> bytes:
    """Return the bytes of a small regular file.

    Type and mode are asked of the open file, so that no other can be put in its place between question and reading; a pipe is
    not waited for.

    Args:
        path: the file.
        what: what it should be, with its article ("the key of the frames"), for the message.
        most_bytes: the most that it may have.
        secret: whether it must be its owner's alone to read and write.

    Raises:
        TransportError: it cannot be read, is no regular file, is too large, or is not its owner's alone.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                raise TransportError(f"{path}: is no regular file, not {what}")
            if secret and stat.S_IMODE(status.st_mode) & 0o077:
                raise TransportError(f"{path}: other users can read it (mode {stat.S_IMODE(status.st_mode):o}); chmod 600 it")
            data = os.read(descriptor, most_bytes + 1)
        finally:
            os.close(descriptor)
    except (OSError, ValueError) as error:  # ValueError: a name with a zero byte
        raise TransportError(f"{path}: {what} cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if len(data) > most_bytes:
        raise TransportError(f"{path}: more than {most_bytes} bytes, too many for {what}")
    return data


def claim_directory() -> Path:
    """Return the directory of the claims of this user; like the buses', it does not depend on the login session."""
    return Path(os.environ.get("HIL_CLAIM_DIR") or f"/tmp/hil-claims-{os.geteuid()}")


class Claim(Closing):
    """A role on a link that one process of this user holds; it goes with the process.

    It is a locked file in a directory that is one user's alone, so that no other user can hold it.

    Processes that see different directories `/tmp`, as in two containers, do not see each other's claims.

    Args:
        uri: of the link, for messages.
        role: what is claimed there.
        where: what distinguishes the place from others, any values with a text.
        choose: what else the user may choose, for the message.

    Raises:
        TransportError: another process holds it, or the directory is not ours alone or cannot be had.
    """

    def __init__(self, uri: str, role: Role, *where: object, choose: str) -> None:
        name = sha256(repr((role, *where)).encode()).hexdigest()
        self._descriptor = -1
        try:
            self._path = private_directory(claim_directory()) / name
            while self._descriptor < 0:
                self._descriptor = _locked(self._path)
        except BlockingIOError:
            raise TransportError(f"link {uri!r}: is another {role} running there? Stop it, or choose {choose}") from None
        except OSError as error:
            raise TransportError(f"link {uri!r}: {claim_directory()}: {error.strerror}") from error
        except TransportError as error:
            raise TransportError(f"link {uri!r}: {error} (HIL_CLAIM_DIR)") from error

    def close(self) -> None:
        """Let go of it; may be called twice."""
        if self._descriptor >= 0:
            with suppress(OSError):
                self._path.unlink()
            os.close(self._descriptor)
            self._descriptor = -1


def namespace(kind: str) -> str:
    """Return the namespace of this process: two ``net`` have two interfaces of one name, two ``time`` two CLOCK_MONOTONIC."""
    try:
        return os.readlink(f"/proc/self/ns/{kind}")
    except OSError:
        return ""


def _locked(path: Path) -> int:
    """Return the locked file of this path, or -1 where its last holder has removed it meanwhile."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(descriptor), os.lstat(path)):
            return descriptor
    except FileNotFoundError:
        pass
    except BaseException:
        os.close(descriptor)
        raise
    os.close(descriptor)
    return -1


BUS_FILE: Final = "bus"
LEFT_BEHIND: Final = ("joined", f"{BUS_FILE}.[0-9]*", f"{BUS_FILE}.new-*")
"""Files beside the sockets of a channel: the mark of the mesh, and the state of a bus that takes time."""

SOCKETS: Final = "[0-9]*-[0-9]*.sock"
"""Process and number: the names of the sockets of a channel."""

_LOCK_S: Final = 0.01


def bus_directory() -> Path:
    """Return the directory that holds the buses of this user.

    It does not depend on the login session, so that a service, a cron job and a shell of one user meet.
    """
    return Path(os.environ.get("HIL_CAN_DIR") or f"/tmp/hil-can-{os.geteuid()}")


def clear_dead_channels(directory: Path) -> None:
    """Remove the sockets of ended processes, and each channel that had no other; what cannot be removed stays.

    A live channel notices nothing: no socket of a process that runs is touched. A folder without a socket is no channel:
    `HIL_CAN_DIR` may name a folder in which others stand.

    Args:
        directory: holds a folder for every channel.
    """
    with suppress(OSError):
        for channel in [each for each in directory.iterdir() if not each.is_symlink() and each.is_dir()]:
            if all(map(_process_runs, channel.glob(SOCKETS))):
                continue
            with suppress(TransportError, OSError), locked(channel, _LOCK_S):
                for path in channel.glob(SOCKETS):
                    if _is_dead(path):
                        path.unlink(missing_ok=True)
                if not any(channel.glob(SOCKETS)):
                    remove_left_behind(channel)


def remove_left_behind(channel: Path) -> None:
    """Remove the folder of a channel without sockets, unless other files are in it.

    Raises:
        OSError: it is not empty, or another user's.
    """
    if all(any(path.match(name) for name in LEFT_BEHIND) for path in channel.iterdir()):
        for path in channel.iterdir():
            path.unlink(missing_ok=True)
    channel.rmdir()


def _process_runs(path: Path) -> bool:
    return Path(f"/proc/{path.name.partition('-')[0]}").exists()


def _is_dead(path: Path) -> bool:
    """Whether nothing listens at a socket; the process of another container is not seen here, but answers."""
    if _process_runs(path) or not stat.S_ISSOCK(path.lstat().st_mode):
        return False
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as knock:
        knock.setblocking(False)
        try:
            knock.connect(os.fspath(path))
        except ConnectionRefusedError:
            return True
        except OSError:
            pass
    return False
