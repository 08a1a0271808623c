"""Be the only one in a role: a locked file in a directory that is one user's alone, so that no other user can hold it."""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

from transport.links.link import Closing, Role, TransportError
from transport.links.private_directory import private_directory


def claim_directory() -> Path:
    """Return the directory of the claims of this user; like the buses', it does not depend on the login session."""
    return Path(os.environ.get("HIL_CLAIM_DIR") or f"/tmp/hil-claims-{os.geteuid()}")


class Claim(Closing):
    """A role on a link that one process of this user holds; it goes with the process.

    Processes that see different directories `/tmp`, as in two containers, do not see each other's claims.

    Args:
        uri: of the link, for messages.
        role: what is claimed there.
        where: what tells the place from others, any values with a text.
        choose: what else the user may choose, for the message.

    Raises:
        TransportError: another process holds it, or the directory is not ours alone or cannot be had.
    """

    __slots__ = ("_descriptor", "_path")

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


def network() -> str:
    """Return the network namespace: two of them have two interfaces of one name."""
    try:
        return os.readlink("/proc/self/ns/net")
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
