"""What killed processes left of their channels: sockets that nothing listens at, and the folders of them."""

from __future__ import annotations

import os
import socket
import stat
from contextlib import suppress
from pathlib import Path
from typing import Final

from transport.links.link import TransportError
from transport.links.private_directory import locked

BUS_FILE: Final = "bus"
LEFT_BEHIND: Final = ("joined", BUS_FILE)
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
    """Remove the sockets of ended processes, and each channel that has no other; what cannot be removed stays.

    A live channel notices nothing: no socket of a process that runs is touched.

    Args:
        directory: holds a folder for every channel.
    """
    with suppress(OSError):
        for channel in [each for each in directory.iterdir() if not each.is_symlink() and each.is_dir()]:
            if all(map(_process_runs, channel.glob(SOCKETS))) and any(channel.glob(SOCKETS)):
                continue
            with suppress(TransportError, OSError), locked(channel, _LOCK_S):
                for path in channel.glob(SOCKETS):
                    if _is_dead(path):
                        path.unlink(missing_ok=True)
                if not any(channel.glob(SOCKETS)) and {path.name for path in channel.iterdir()} <= set(LEFT_BEHIND):
                    for name in LEFT_BEHIND:
                        (channel / name).unlink(missing_ok=True)
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
