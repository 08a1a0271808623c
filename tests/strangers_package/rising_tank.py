"""A foreign package but for its plant: a law, a controller of two samples, a measure and a link, over public faces alone."""

from __future__ import annotations

import os
import select
import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np

from transport import LinkCounters, TransportError


@dataclass(frozen=True, kw_only=True)
class Sticky:
    """A chain law: the newest packet is of this slot, or of the slot before; it changes with one probability."""

    kind: ClassVar[str] = "sticky"
    family: ClassVar[Literal["age", "packet"]] = "age"
    change: float = 0.3
    mode_ages: ClassVar[tuple[int, int]] = (0, 1)

    @property
    def max_age(self) -> int:
        return 1

    def transition_matrix(self) -> np.ndarray:
        return np.array([[1.0 - self.change, self.change], [self.change, 1.0 - self.change]])

    def start(self, rng: np.random.Generator) -> StickyRun:
        return StickyRun(self.change, rng)


class StickyRun:
    def __init__(self, change: float, rng: np.random.Generator) -> None:
        self._change, self._rng = change, rng
        self._mode = int(rng.random() < 0.5)

    def draw(self) -> tuple[int, int]:
        now = self._mode
        self._mode = now ^ int(self._rng.random() < self._change)
        return now, now


@dataclass(frozen=True, kw_only=True)
class Difference:
    """u = gain (y - r) + slope (y - y before): two samples in every sensor packet, one row for every d."""

    gain: float = -0.3
    slope: float = -0.2
    selection: ClassVar[str] = "constant"
    samples: ClassVar[int] = 2

    def table(self, model: Any) -> np.ndarray:
        row = np.array([self.gain + self.slope, -self.slope])
        return np.broadcast_to(row, (model.tau_max + 1, 1, 1, 2)).copy()

    def start(self, model: Any) -> Difference:
        return self

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> tuple[tuple[float, ...], ...]:
        return ((self.gain * (y[0] - r[0]) + self.slope * (y[0] - y[1]),),)


class Wear:
    """How far the input travelled."""

    title: ClassVar[str] = "Wear"
    note: ClassVar[str] = "Way of the input that was applied."
    topics: ClassVar[tuple[str, ...]] = ("/actuator/applied",)

    def quantities(self, signals: Any) -> tuple[Any, ...]:
        from hil.measure import Quantity

        return (Quantity(name="wear", title="way of the input", unit=signals.input_unit(), per_output=False),)

    def of(self, view: Any) -> Mapping[str, float]:
        return {"wear": float(np.abs(np.diff(view.applied(), axis=0)).sum())}


class Datagrams:
    """One end of a pair of UNIX datagram sockets."""

    def __init__(self, uri: str, own: Path, other: Path) -> None:
        self.uri, self.counters = uri, LinkCounters()
        self._own, self._other = own, str(other)
        self._socket: socket.socket | None = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        own.unlink(missing_ok=True)
        self._socket.bind(str(own))

    def send(self, packet: bytes) -> None:
        try:
            if self._socket is None:
                raise OSError("closed")
            self._socket.sendto(packet, self._other)
            self.counters.sent += 1
        except OSError:
            self.counters.dropped += 1

    def receive(self, timeout_s: float) -> bytes | None:
        if self._socket is None:
            return None
        try:
            ready = select.select((self._socket,), (), (), max(timeout_s, 0.0))[0]
            data = self._socket.recv(65536) if ready else None
        except OSError:
            return None
        self.counters.received += data is not None
        return data

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None
            self._own.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def open_datagrams(uri: str, role: Literal["rig", "controller"]) -> Datagrams:
    """``datagrams:FOLDER``: two sockets in a folder that is there."""
    folder = Path(uri.partition(":")[2].partition("?")[0])
    if not folder.is_dir():
        raise TransportError(f"link {uri!r}: {os.fspath(folder)!r} is no folder")
    ends = {"rig": folder / "rig.sock", "controller": folder / "controller.sock"}
    return Datagrams(uri, ends.pop(role), *ends.values())
