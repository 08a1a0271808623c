"""One CAN bus that takes time for several processes: its state stands in a file, and whoever holds the lock lets time pass.

The bus is that of `transport.can_bus_model.bus`, in the time of CLOCK_MONOTONIC. Every participant queues its frames there, lets
time pass until now, and finds in its own list what has become of its frames: it hands out those that got through. No node decides
for the others: any process comes to the same, as arbitration is decided by the instants at which frames were queued.

Frames are handed out in the order of the bus: under the lock, and not before those of others that ended earlier, unless their
sender is too late for that by `PATIENCE_NS`.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic_ns
from typing import Any, Final, NamedTuple

from transport.can_bus_model.bit_rates import BitRates
from transport.can_bus_model.bits import CanFrame
from transport.can_bus_model.bus import CanBus, CanNode
from transport.can_bus_model.node import State, Waiting
from transport.can_bus_model.saved_bus import restored, saved
from transport.links.link import TransportError
from transport.links.mesh_peer import BUS_FILE

_MOST_BYTES: Final = 4_000_000
PATIENCE_NS: Final = 100_000_000
_AGAIN_NS: Final = 100_000


class Ended(NamedTuple):
    """What has become of a frame of one's own.

    Attributes:
        tag: number that its sender gave it.
        end_ns: end of its EOF or error delimiter, CLOCK_MONOTONIC.
        sent: whether it got through; otherwise it is sent again.
    """

    tag: int
    end_ns: int
    sent: bool


class Seen(NamedTuple):
    """What a participant finds when it looks.

    Attributes:
        next_ns: when there may be something to hand out, CLOCK_MONOTONIC; None if nothing happens by itself.
        in_vain: frames of its own were destroyed, and none got through.
        waiting: frames of its own that wait or are being sent.
        state: its error state.
        tec, rec: its error counters.
    """

    in_vain: bool
    next_ns: int | None
    waiting: int
    state: State
    tec: int
    rec: int


class SharedBus:
    """One participant of a bus that takes time.

    Args:
        directory: where the participants meet; it is private and there.
        rates: of this participant. The first one's are the bus's; who comes with others destroys what it cannot read.
            A participant that is off the bus stays off until it joins anew, as a driver does that is not told to restart.
        ended: called with what has become of each frame of its own, while the bus is locked.

    Raises:
        TransportError: the file cannot be had.
    """

    def __init__(self, directory: Path, rates: BitRates, ended: Callable[[Ended], None]) -> None:
        self._ended = ended
        try:
            flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
            self._file = os.open(directory / BUS_FILE, flags, 0o600)
        except OSError as error:
            raise TransportError(f"{directory / BUS_FILE}: {error.strerror}") from error
        self._pid = os.getpid()
        with self._held() as held:
            self._sweep(held)
            if held.bus is None or not any(held.owners):
                held.start(rates)
            bus = held.bus
            assert bus is not None
            node = CanNode(buffer="fifo", recovers=False, rates=None if bus.rates == rates else rates)
            free = held.owners.index(0) if 0 in held.owners else None
            self._node = bus.join(node, free)
            held.owners[self._node : self._node + 1] = [self._pid]
            held.mail[self._node : self._node + 1] = [[]]

    @contextmanager
    def _held(self) -> Iterator[_Held]:
        fcntl.flock(self._file, fcntl.LOCK_EX)
        try:
            size = min(os.fstat(self._file).st_size, _MOST_BYTES)  # room for more is memory that a locked process has to clear
            held = _Held(os.pread(self._file, size, 0))
            yield held
            text = held.text()
            os.pwrite(self._file, text, 0)
            os.ftruncate(self._file, len(text))
        finally:
            fcntl.flock(self._file, fcntl.LOCK_UN)

    def _sweep(self, held: _Held) -> None:
        """Take those off the bus whose process is gone."""
        for i, pid in enumerate(held.owners):
            if pid and not _alive(pid):
                held.leave(i)

    def queue(self, frames: Sequence[tuple[CanFrame, int]]) -> Seen:
        """Let frames wait from now on, one behind the other.

        Args:
            frames: what is sent, each with the number by which `Ended.tag` names it.
        """
        with self._held() as held:
            now = monotonic_ns()
            held.advance(now)
            for frame, tag in frames:
                held.living.queue(self._node, Waiting(frame, BitRates.units(now), tag))
            return self._seen(held, now)

    def look(self) -> Seen:
        """Let time pass until now."""
        with self._held() as held:
            now = monotonic_ns()
            held.advance(now)
            return self._seen(held, now)

    def _seen(self, held: _Held, now: int) -> Seen:
        due, more = held.due(self._node, now)
        for each in due:
            self._ended(each)
        bus = held.living
        node, following = bus.nodes[self._node], bus.next_instant()
        next_ns = now + _AGAIN_NS if more else None if following is None else BitRates.ns(following)
        in_vain = bool(due) and not any(each.sent for each in due)
        return Seen(in_vain, next_ns, len(node.waiting), node.errors.state, node.errors.tec, node.errors.rec)

    def sweep(self) -> None:
        """Take those off the bus whose process is gone; they acknowledge nothing."""
        with self._held() as held:
            held.advance(monotonic_ns())
            self._sweep(held)

    def close(self) -> None:
        """Leave the bus; what waits is not sent."""
        if self._file >= 0:
            with suppress(OSError, ValueError), self._held() as held:
                held.advance(monotonic_ns())
                held.leave(self._node)
            os.close(self._file)
            self._file = -1


class _Held:
    """The bus while the lock is held."""

    def __init__(self, text: bytes) -> None:
        self.bus: CanBus | None = None
        self.owners: list[int] = []
        self.mail: list[list[Any]] = []
        with suppress(ValueError, TypeError, IndexError, KeyError):  # a file that holds none begins a new one
            state, owners, mail = json.loads(text)
            self.bus, self.owners, self.mail = restored(state), owners, mail

    @property
    def living(self) -> CanBus:
        if self.bus is None:
            raise TransportError("the file of the bus was emptied by another program")
        return self.bus

    def start(self, rates: BitRates) -> None:
        self.bus, self.owners, self.mail = CanBus(rates, [], idle=BitRates.units(monotonic_ns())), [], []

    def advance(self, now_ns: int) -> None:
        for each in self.living.advance(BitRates.units(now_ns)):
            if self.owners[each.node]:
                self.mail[each.node].append([each.waiting.tag, BitRates.ns(each.end), each.error_bit is None])

    def leave(self, i: int) -> None:
        self.living.leave(i)
        self.owners[i], self.mail[i] = 0, []

    def due(self, i: int, now_ns: int) -> tuple[list[Ended], bool]:
        """Take what one participant may hand out; return whether more of its own waits for others."""
        others = [end for j, mail in enumerate(self.mail) for _, end, sent in mail if j != i and sent]
        first = min((end for end in others if end > now_ns - PATIENCE_NS), default=now_ns)
        mine = [Ended(*each) for each in self.mail[i]]
        self.mail[i] = [list(each) for each in mine if each.end_ns > first]
        return [each for each in mine if each.end_ns <= first], bool(self.mail[i])

    def text(self) -> bytes:
        return json.dumps([saved(self.living), self.owners, self.mail], separators=(",", ":")).encode()


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
