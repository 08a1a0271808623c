"""The processes in which a functional mock-up unit runs, so that whatever its native code does ends nothing else.

Started as a script, with its end of a socket on standard input. The host unpacks the unit once and forks a runner for every
instance; it owns the folder and removes it when its user is gone, however that ended. What the unit prints goes to stderr.
"""

from __future__ import annotations

import ctypes
import fcntl
import json
import os
import resource
import shutil
import signal
import socket
import stat
import struct
import tempfile
import time
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

PREFIX = "hilrig-fmu-"
LOCK = "lock"
YOUNG_S = 60.0
"""A folder without a lock may be one that is just being made."""

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36
DONE, FAILED, ENDED = b"+", b"-", b"."
STEP = struct.Struct("=qq")
"""Session time and length of a step, ns; the inputs follow as doubles."""

LONGEST_END_S = 0.5


def main() -> None:
    """Serve one user: ``J`` + JSON unpacks, ``S`` with a socket starts a runner, ``W`` + its number says how it ended."""
    with socket.socket(fileno=os.dup(0)) as user:
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(2, 1)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)  # what a unit starts and leaves becomes a child of this one
        remove_left_behind(tempfile.gettempdir())
        folder = tempfile.mkdtemp(prefix=PREFIX)
        lock = os.open(os.path.join(folder, LOCK), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        fcntl.flock(lock, fcntl.LOCK_EX)
        runners: dict[int, int | None] = {}
        try:
            _serve(user, os.path.join(folder, "unit"), runners)
        finally:
            _sweep()
            shutil.rmtree(folder, ignore_errors=True)


def _serve(user: socket.socket, folder: str, runners: dict[int, int | None]) -> None:
    job: dict[str, Any] = {}
    while True:
        data, handles, _, _ = socket.recv_fds(user, 1 << 16, 1)
        if not data:
            return
        _reap(runners)
        if data[:1] == b"J":
            job = json.loads(data[1:])
            user.send(_unpack(job["path"], folder))
        elif data[:1] == b"S":
            pid = os.fork()
            if pid == 0:
                user.close()
                _run(Connection(handles[0]), job, folder)
            os.close(handles[0])
            runners[pid] = None
            user.send(str(pid).encode())
        else:
            user.send(str(_how(int(data[1:]), runners)).encode())


def _sweep() -> None:
    """Kill and reap children until none is left: runners, and what units have started."""
    while children := [pid for pid in map(int, filter(str.isdecimal, os.listdir("/proc"))) if _parent(pid) == os.getpid()]:
        for pid in children:
            os.kill(pid, signal.SIGKILL)  # not reaped yet, so the number is still its own
        os.waitpid(children[0], 0)


def _parent(pid: int) -> int:
    try:
        with open(f"/proc/{pid}/stat", "rb") as file:
            return int(file.read().rpartition(b")")[2].split()[1])
    except OSError:  # it has just ended
        return 0


def _reap(runners: dict[int, int | None]) -> None:
    for pid in [pid for pid, status in runners.items() if status is None]:
        found, status = os.waitpid(pid, os.WNOHANG)
        if found:
            runners[pid] = os.waitstatus_to_exitcode(status)


def _how(pid: int, runners: dict[int, int | None]) -> int:
    """Return the exit status of a runner that no longer answers."""
    end = time.monotonic() + LONGEST_END_S
    while runners.get(pid, 0) is None and time.monotonic() < end:
        _reap(runners)
        time.sleep(0.005)
    if runners.get(pid) is None:
        os.kill(pid, signal.SIGKILL)
        runners[pid] = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    return runners[pid] or 0


def _unpack(path: str, folder: str) -> bytes:
    import fmpy

    try:
        fmpy.extract(path, folder)
    except Exception as error:  # FMPy raises what it likes
        return FAILED + f"{type(error).__name__}: {error}".encode()[:2000]
    return DONE


def _run(user: Connection, job: dict[str, Any], folder: str) -> None:
    """Run one instance, and never return."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    status = 1
    try:
        instance = Instance(job, folder)
        user.send_bytes(DONE + instance.values())
        while True:
            status = 0
            data = user.recv_bytes()
            status = 1
            ended = instance.step(data)
            user.send_bytes((ENDED if ended else DONE) + instance.values())
    except EOFError:
        pass
    except BaseException as error:
        with suppress(OSError):
            user.send_bytes(FAILED + f"{type(error).__name__}: {error}".encode()[:2000])
    finally:
        os._exit(status)


class Instance:
    """A unit at time 0.

    Args:
        job: what `plants.fmu.Unit` holds.
        folder: where it is unpacked.
    """

    def __init__(self, job: dict[str, Any], folder: str) -> None:
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        two = job["version"] == 2
        made: Any = FMU2Slave if two else FMU3Slave
        slave = made(guid=job["token"], unzipDirectory=folder, modelIdentifier=job["identifier"], instanceName="plant")
        slave.instantiate()
        self._slave = slave
        self._set, self._get = (slave.setReal, slave.getReal) if two else (slave.setFloat64, slave.getFloat64)
        if two:
            slave.setupExperiment(startTime=0.0)
        references, values = job["parameters"]
        if references:
            self._set(references, values)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        self._commanded, self._measured, self._logged = job["references"]

    def step(self, data: bytes) -> bool:
        """Hold the inputs for a step; return whether the unit ended the simulation."""
        t_ns, dt_ns = STEP.unpack_from(data)
        self._set(self._commanded, list(struct.unpack_from(f"={len(self._commanded)}d", data, STEP.size)))
        ended = self._slave.doStep(t_ns / 1e9, dt_ns / 1e9)
        return isinstance(ended, tuple) and bool(ended[1])

    def values(self) -> bytes:
        """Return what is measured, and what is logged."""
        found = [*map(float, self._get(self._measured)), *map(float, self._get(self._logged))]
        return struct.pack(f"={len(found)}d", *found)


def remove_left_behind(folder: str) -> None:
    """Remove what hosts of this user left behind that were killed: no process holds its lock."""
    for entry in os.scandir(folder):
        with suppress(OSError):
            about = entry.stat(follow_symlinks=False)
            if not entry.name.startswith(PREFIX) or not stat.S_ISDIR(about.st_mode) or about.st_uid != os.geteuid():
                continue
            try:
                lock = os.open(os.path.join(entry.path, LOCK), os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
            except FileNotFoundError:
                if time.time() - about.st_mtime > YOUNG_S:
                    shutil.rmtree(entry.path, ignore_errors=True)
                continue
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(entry.path, ignore_errors=True)
            finally:
                os.close(lock)


if __name__ == "__main__":
    main()
