"""A CAN bus that takes time, shared by several processes: its state is in a file, and the holder of its lock advances it.

The bus is that of `transport.can_bus_model.bus`, in the time of CLOCK_MONOTONIC. Every participant queues its frames there, lets
time pass until now, and finds in its own list what has become of its frames: it hands out those that got through. No node decides
for the others: any process comes to the same, as arbitration is decided by the instants at which frames were queued. What a
stopped participant has queued is sent, and it acknowledges what others send, as a CAN controller does whose processor has halted.

Frames are handed out in the order of the bus: under the lock, and not before those of others that ended earlier, unless their
sender is too late for that by `transport.links.held_bus.PATIENCE_NS`.

A process that is killed lets go of the lock; one that is stopped (SIGSTOP, a debugger) does not. After `HELD_S` the next process
goes on in a file of the next number, ``bus.1`` behind ``bus.0``, with the state that was last written; only one can make it, as a
link has one name. A process that wakes up finds that there is a newer file, and repeats there what it was about to do. A state is
written beside the one before it, and counts with the head that says where it is: a process that ends in the middle of writing
leaves the one before it.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from struct import Struct
from time import monotonic, monotonic_ns, sleep
from typing import Final, NamedTuple

from transport.can_bus_model import BitRates, CanFrame
from transport.can_bus_model.disturbances import BusFault
from transport.can_bus_model.node import CanNode, State, Waiting
from transport.links import Closing, TransportError
from transport.links.held_bus import Ended, HeldBus, StateChange
from transport.links.private_directory import BUS_FILE, namespace

HELD_S: Final = 0.25
"""So long a process may hold the bus before the others go on without it, s."""

_HEAD: Final = Struct("<QQ")  # where the state is, and its length
_MOST_BYTES: Final = 4_000_000
_PAUSE_S: Final = 50e-6
_LONGEST_PAUSE_S: Final = 2e-3


class BusFile(Closing):
    """One process's hand on the file.

    Args:
        directory: where the participants meet; it is private and there.

    Raises:
        TransportError: the file cannot be had.
    """

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._file = -1
        try:
            self._open_newest()
        except OSError as error:
            raise TransportError(f"{directory / BUS_FILE}: {error.strerror}") from error

    def _path(self, number: int) -> Path:
        return self._directory / f"{BUS_FILE}.{number}"

    def _open_newest(self) -> None:
        self.close()
        names = [path.name.rpartition(".")[2] for path in self._directory.glob(f"{BUS_FILE}.[0-9]*")]
        self._number: int = max((int(name) for name in names if name.isdecimal()), default=0)
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
        self._file = os.open(self._path(self._number), flags, 0o600)

    def _is_newest(self) -> bool:
        return os.fstat(self._file).st_nlink > 0 and not self._path(self._number + 1).exists()

    def change(self, change: Callable[[bytes], bytes]) -> None:
        """Replace the state by what a function makes of it, while no other process does.

        Args:
            change: takes the state, empty if there is none. It is called again where others went on without us meanwhile, with
                a state that may hold what the first call returned, or not.
        """
        while True:
            self._lock()
            try:
                text = change(self._read(self._file, self._number))
                if self._is_newest():
                    self._write(text)
                    if self._is_newest():
                        return
            finally:
                fcntl.flock(self._file, fcntl.LOCK_UN)

    def _lock(self) -> None:
        limit, pause = monotonic() + HELD_S, _PAUSE_S
        while True:
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if monotonic() < limit:
                    sleep(pause)
                    pause = min(2 * pause, _LONGEST_PAUSE_S)
                    continue
                if self._go_on_without():
                    return
            else:
                if self._is_newest():
                    return
            self._open_newest()
            limit = monotonic() + HELD_S

    def _go_on_without(self) -> bool:
        """Make the file of the next number, locked by us; return False if another process has made it."""
        new = self._directory / f"{BUS_FILE}.new-{os.getpid()}-{self._file}"
        descriptor = os.open(new, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.link(new, self._path(self._number + 1))
        except FileExistsError:
            os.close(descriptor)
            return False
        finally:
            with suppress(FileNotFoundError):
                new.unlink()
        self.close()
        self._file, self._number = descriptor, self._number + 1
        return True

    def _read(self, file: int, number: int) -> bytes:
        """Return the state; as long as nothing is written in this file that of the one before it."""
        head = os.pread(file, _HEAD.size, 0)
        if len(head) == _HEAD.size:
            place, length = _HEAD.unpack(head)
            if place < 2 * _MOST_BYTES and length <= _MOST_BYTES:  # room for more is memory that must be cleared first
                return os.pread(file, length, place)
            return b""
        if number == 0:
            return b""
        try:
            before = os.open(self._path(number - 1), os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
        except FileNotFoundError:
            return b""
        try:
            return self._read(before, number - 1)
        finally:
            os.close(before)

    def _write(self, text: bytes) -> None:
        head = os.pread(self._file, _HEAD.size, 0)
        first = len(head) < _HEAD.size
        place = _HEAD.size if first or _HEAD.unpack(head)[0] > _HEAD.size else _HEAD.size + _MOST_BYTES
        os.pwrite(self._file, text, place)
        os.pwrite(self._file, _HEAD.pack(place, len(text)), 0)
        if first and self._number:
            for older in range(self._number):
                self._path(older).unlink(missing_ok=True)

    def close(self) -> None:
        """Let go of the file; may be called twice."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


_AGAIN_NS: Final = 100_000


class Seen(NamedTuple):
    """What a participant finds when it looks.

    Attributes:
        next_ns: when there may be something to hand out, CLOCK_MONOTONIC; None if nothing happens by itself.
        in_vain: frames of its own were destroyed, and none got through.
        waiting: frames of its own that wait or are being sent.
        state: its error state.
    """

    in_vain: bool
    next_ns: int | None
    waiting: int
    state: State


class SharedBus:
    """One participant of a bus that takes time.

    Args:
        directory: where the participants meet; it is private and there.
        rates: of this participant. Those of the first are the bus's; a participant with others destroys what it cannot read.
        ended: called with what has become of each frame of its own, while the bus is locked; twice where other processes went on
            without this one meanwhile.
        changed: called with each change of its error state, in order with those; likewise.
        others_changed: called while the bus is locked, before `ended`, when time that passed here has changed the error state
            of another participant.

    A participant that is off the bus stays off until it joins again, or asks to `restart`.

    Raises:
        TransportError: the file cannot be had, or the bus has another clock.
    """

    def __init__(
        self, directory: Path, rates: BitRates, ended: Callable[[Ended], None],
        changed: Callable[[StateChange], None] = lambda change: None, others_changed: Callable[[], None] = lambda: None,
    ) -> None:  # fmt: skip
        self._ended, self._own_changed, self._others_changed = ended, changed, others_changed
        self._file = BusFile(directory)
        self._own = int.from_bytes(os.urandom(4)) << 32 | os.getpid()
        self._node = -1
        try:
            self._file.change(partial(self._join, rates))
        except BaseException:
            self._file.close()
            raise

    def _join(self, rates: BitRates, text: bytes) -> bytes:
        held = HeldBus(text)
        held.sweep()
        if held.bus is None or not any(held.owners):
            held.start(rates)
        if held.clock != namespace("time"):
            raise TransportError("the bus counts the time of another time namespace, as a container may have; join it from there")
        if self._own in held.owners:
            self._node = held.owners.index(self._own)
        else:
            node = CanNode(buffer="fifo", recovers=False, rates=None if held.living.rates == rates else rates)
            self._node = held.join(node, self._own)
        return held.text()

    def _change(self, change: Callable[[HeldBus, int], object]) -> Seen:
        """Let time pass until now, change the bus at this instant, and take what there is for this participant."""
        found: list[Seen] = []

        def changed(text: bytes) -> bytes:
            held, now = HeldBus(text), monotonic_ns()
            if held.advance(now) - {self._node}:
                self._others_changed()
            change(held, now)
            found.append(self._seen(held, now))
            return held.text()

        self._file.change(changed)
        return found[-1]

    def queue(self, frames: Sequence[tuple[CanFrame, int]]) -> Seen:
        """Let frames wait from now on, one behind the other.

        Args:
            frames: what is sent, each with the number by which `Ended.tag` names it; larger from frame to frame.
        """

        def change(held: HeldBus, now: int) -> None:
            for frame, tag in frames:
                held.queue(self._node, Waiting(frame, BitRates.units(now), tag))

        return self._change(change)

    def look(self) -> Seen:
        """Let time pass until now."""
        return self._change(lambda held, now: None)

    def restart(self) -> Seen:
        """Come back from bus-off after 128 times 11 recessive bits from now on, as a driver does on a request to restart."""
        return self._change(lambda held, now: held.living.switch_on(self._node, BitRates.units(now)))

    def plan(self, faults: Sequence[BusFault], seed: int, senders: Sequence[Sequence[int]]) -> Seen:
        """Replace what is wrong with the bus when.

        Args:
            faults: their instants in CLOCK_MONOTONIC, ns; `off` has places in ``senders``.
            seed: of the bits that are disturbed at random.
            senders: of each node that faults take off the bus identifiers: who sent one of them last. An empty one is this
                participant.
        """

        def change(held: HeldBus, now: int) -> None:
            places = [held.who_sent(ids) if ids else (self._node,) for ids in senders]
            meant = [fault._replace(off=tuple(i for place in fault.off for i in places[place])) for fault in faults]
            held.plan(meant, seed, now)

        return self._change(change)

    def sweep(self) -> Seen:
        """Take those off the bus whose process is gone; they acknowledge nothing."""
        return self._change(lambda held, now: held.sweep())

    def _seen(self, held: HeldBus, now: int) -> Seen:
        due, more = held.due(self._node, now)
        happened: list[tuple[int, Callable[[], None]]] = [(each.end_ns, partial(self._ended, each)) for each in due]
        happened += [(each.at_ns, partial(self._own_changed, each)) for each in held.changes_of(self._node)]
        for _, notify in sorted(happened, key=lambda each: each[0]):
            notify()
        bus = held.living
        node, following = bus.nodes[self._node], bus.next_instant()
        next_ns = now + _AGAIN_NS if more else None if following is None else BitRates.ns(following)
        in_vain = bool(due) and all(each.error_bit is not None for each in due)
        return Seen(in_vain, next_ns, len(node.waiting), node.errors.state)

    def close(self) -> None:
        """Leave the bus; what waits is not sent. May be called twice."""
        if self._node >= 0:
            node, self._node = self._node, -1

            def leave(text: bytes) -> bytes:
                held = HeldBus(text)
                held.advance(monotonic_ns())
                if held.owners[node] == self._own:
                    held.leave(node)
                return held.text()

            with suppress(OSError, ValueError, IndexError, TransportError):
                self._file.change(leave)
            self._file.close()
