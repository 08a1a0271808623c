"""A functional mock-up unit that runs, seen from the rig: one message a step to the process that holds its native code."""

from __future__ import annotations

import json
import os
import signal
import socket
import struct
import subprocess
import sys
import weakref
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Final

from plants import fmu_host
from plants.errors import PlantError
from plants.fmu_host import DONE, ENDED, FAILED, STEP
from plants.parts import NS_PER_S

if TYPE_CHECKING:
    from plants.fmu import Unit

_END_S: Final = 2.0


class Host:
    """The process that holds a unit's folder and starts its runners; it ends with this object, and with this process.

    Args:
        unit: what was found in the file.

    Raises:
        PlantError: the unit cannot be unpacked.
    """

    def __init__(self, unit: Unit) -> None:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._path, self._socket = unit.path, ours
        with theirs:  # a session of its own: Ctrl-C of the terminal is for the rig, which ends it
            process = subprocess.Popen(
                [sys.executable, "-P", str(Path(fmu_host.__file__))], stdin=theirs.fileno(), stdout=2, start_new_session=True
            )
        self._process = process.pid
        self._end = weakref.finalize(self, _end, ours, process)
        job = {
            "path": unit.path, "version": unit.version, "identifier": unit.identifier, "token": unit.token,
            "references": unit.references, "parameters": unit.parameters,
        }  # fmt: skip
        said = self._asked(b"J" + json.dumps(job).encode())
        if said[:1] != DONE:
            self._end()
            raise PlantError(f"{self._path}: cannot be unpacked: {said[1:].decode(errors='replace')}")

    def start(self) -> tuple[Connection, int]:
        """Return a connection to a new runner, and the number of its process."""
        ours, theirs = socket.socketpair()
        with theirs:
            pid = int(self._asked(b"S", theirs.fileno()))
        return Connection(ours.detach()), pid

    def how(self, pid: int) -> str:
        """Return how the process of a runner ended."""
        status = int(self._asked(b"W" + str(pid).encode()))
        return f"was killed by {signal.Signals(-status).name}" if status < 0 else f"ended its process with status {status}"

    def _asked(self, data: bytes, handle: int | None = None) -> bytes:
        try:
            if handle is None:
                self._socket.send(data)
            else:
                socket.send_fds(self._socket, [data], [handle])
            said = self._socket.recv(1 << 16)
        except OSError as error:
            raise PlantError(f"{self._path}: the process that holds the unit is gone: {error.strerror or error}") from error
        if not said:
            raise PlantError(f"{self._path}: the process that holds the unit is gone")
        return said


def _end(ours: socket.socket, process: subprocess.Popen[bytes]) -> None:
    ours.close()  # at this it ends its runners, removes its folder and goes
    try:
        process.wait(_END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


@cache
def _host(unit: Unit, digest: str, process: int) -> Host:
    return Host(unit)


class FMURun:
    """A unit that runs.

    Args:
        unit: what was found in its file.
        digest: SHA-256 of the file: another file is another host.

    Raises:
        PlantError: it does not start.
    """

    __slots__ = ("__weakref__", "_applied", "_format", "_host", "_outputs", "_pid", "_t_ns", "_unit", "_user", "_values")

    def __init__(self, unit: Unit, digest: str) -> None:
        commanded, measured, logged = map(len, unit.references)
        self._unit, self._t_ns, self._applied = unit, 0, (0.0,) * commanded
        self._outputs, self._format = measured, struct.Struct(f"={measured + logged}d")
        self._values: tuple[float, ...] = ()
        self._host = _host(unit, digest, os.getpid())
        self._user, self._pid = self._host.start()
        weakref.finalize(self, self._user.close)
        _as_urgent(self._pid)
        self._receive("while it started")

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        """Hold the input u + w for dt_ns.

        Args:
            dt_ns: time in nanoseconds, at least 0.
            u: commanded input, m entries.
            w: disturbance at the input, m entries, or nothing.

        Raises:
            PlantError: the unit failed, crashed, or ended the simulation.
        """
        self._applied = tuple(map(float, u))
        if not dt_ns:
            return
        held = [a + b for a, b in zip(u, w)] if w else u
        with suppress(OSError):  # a process that is gone is reported below
            self._user.send_bytes(STEP.pack(self._t_ns, dt_ns) + struct.pack(f"={len(held)}d", *held))
        self._t_ns += dt_ns
        self._receive(f"in the step to {self._t_ns / NS_PER_S:g} s")

    def _receive(self, when: str) -> None:
        try:
            data = self._user.recv_bytes()
        except (EOFError, OSError):
            raise PlantError(f"{self._unit.path}: the unit {self._host.how(self._pid)} {when}") from None
        if data[:1] == FAILED:
            raise PlantError(f"{self._unit.path}: the unit failed {when}: {data[1:].decode(errors='replace')}")
        if data[:1] == ENDED:
            raise PlantError(f"{self._unit.path}: the unit ended the simulation {when}")
        try:
            self._values = self._format.unpack(data[1:])
        except struct.error:  # native code that wrote to the descriptors of its process
            text = f"{self._unit.path}: the unit's process answered {len(data)} bytes that are no values, {when}"
            raise PlantError(text) from None

    def measure(self) -> tuple[float, ...]:
        """Return what is measured."""
        return self._values[: self._outputs]

    @property
    def state(self) -> tuple[float, ...]:
        """What is logged."""
        return self._values[self._outputs :]

    @property
    def applied(self) -> tuple[float, ...]:
        """What was commanded in the last advance, without the disturbance."""
        return self._applied


def _as_urgent(pid: int) -> None:
    """Give a process the scheduling of this one: the rig waits for it in every slot."""
    policy = os.sched_getscheduler(0)
    if policy != os.SCHED_OTHER:
        with suppress(OSError):
            os.sched_setscheduler(pid, policy, os.sched_getparam(0))
