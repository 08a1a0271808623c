"""A CAN bus that takes time, shared by several processes: its state is in a file, and the holder of its lock advances it.

The bus is that of `transport.can_bus_model.bus`, in the time of CLOCK_MONOTONIC. Every participant queues its frames there, lets
time pass until now, and finds in its own list what has become of its frames: it hands out those that got through. No node decides
for the others: any process comes to the same, as arbitration is decided by the instants at which frames were queued. What a
stopped participant has queued is sent, and it acknowledges what others send, as a CAN controller does whose processor has halted.

Frames are handed out in the order of the bus: under the lock, and not before those of others that ended earlier, unless their
sender is too late for that by `transport.links.held_bus.PATIENCE_NS`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from time import monotonic_ns
from typing import Final, NamedTuple, TypeVar

from transport.can_bus_model import BitRates, CanFrame
from transport.can_bus_model.disturbances import BusFault
from transport.can_bus_model.node import CanNode, State, Waiting
from transport.links import TransportError
from transport.links.bus_file import BusFile
from transport.links.held_bus import Ended, HeldBus, StateChange

_AGAIN_NS: Final = 100_000

Found = TypeVar("Found")


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

    A participant that is off the bus stays off until it joins anew, or asks to `restart`.

    Raises:
        TransportError: the file cannot be had.
    """

    def __init__(
        self, directory: Path, rates: BitRates, ended: Callable[[Ended], None],
        changed: Callable[[StateChange], None] = lambda change: None, others_changed: Callable[[], None] = lambda: None,
    ) -> None:  # fmt: skip
        self._ended, self._own_changed, self._others_changed = ended, changed, others_changed
        self._file = BusFile(directory)
        self._own = int.from_bytes(os.urandom(4)) << 32 | os.getpid()
        self._node = -1
        self._change(lambda held: self._join(held, rates))

    def _join(self, held: HeldBus, rates: BitRates) -> None:
        held.sweep()
        if held.bus is None or not any(held.owners):
            held.start(rates)
        bus = held.living
        if self._own in held.owners:
            self._node = held.owners.index(self._own)
            return
        node = CanNode(buffer="fifo", recovers=False, rates=None if bus.rates == rates else rates)
        self._node = held.join(node, self._own)

    def _change(self, change: Callable[[HeldBus], Found]) -> Found:
        found: list[Found] = []

        def changed(text: bytes) -> bytes:
            held = HeldBus(text)
            found.append(change(held))
            return held.text()

        self._file.change(changed)
        return found[-1]

    def _pass(self, held: HeldBus) -> int:
        """Let time pass until now; return the instant."""
        now = monotonic_ns()
        if held.advance(now) - {self._node}:
            self._others_changed()
        return now

    def queue(self, frames: Sequence[tuple[CanFrame, int]]) -> Seen:
        """Let frames wait from now on, one behind the other.

        Args:
            frames: what is sent, each with the number by which `Ended.tag` names it; larger from frame to frame.
        """

        def change(held: HeldBus) -> Seen:
            now = self._pass(held)
            for frame, tag in frames:
                held.queue(self._node, Waiting(frame, BitRates.units(now), tag))
            return self._seen(held, now)

        return self._change(change)

    def look(self) -> Seen:
        """Let time pass until now."""
        return self._change(lambda held: self._seen(held, self._pass(held)))

    def restart(self) -> Seen:
        """Come back from bus-off after 128 times 11 recessive bits from now on, as a driver does on a request to restart."""

        def change(held: HeldBus) -> Seen:
            now = self._pass(held)
            held.living.switch_on(self._node, BitRates.units(now))
            return self._seen(held, now)

        return self._change(change)

    def plan(self, faults: Sequence[BusFault], seed: int, senders: Sequence[Sequence[int]]) -> None:
        """Replace what is wrong with the bus when.

        Args:
            faults: their instants in CLOCK_MONOTONIC, ns; `off` has places in ``senders``.
            seed: of the bits that are disturbed at random.
            senders: of each node that faults take off the bus identifiers: who sent one of them last. An empty one is this
                participant.
        """

        def change(held: HeldBus) -> None:
            now = self._pass(held)
            places = [held.who_sent(ids) if ids else (self._node,) for ids in senders]
            meant = [fault._replace(off=tuple(i for place in fault.off for i in places[place])) for fault in faults]
            held.plan(meant, seed, now)

        self._change(change)

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

    def sweep(self) -> None:
        """Take those off the bus whose process is gone; they acknowledge nothing."""

        def change(held: HeldBus) -> None:
            self._pass(held)
            held.sweep()

        self._change(change)

    def close(self) -> None:
        """Leave the bus; what waits is not sent. May be called twice."""
        if self._node >= 0:
            node, self._node = self._node, -1

            def change(held: HeldBus) -> None:
                held.advance(monotonic_ns())
                if held.owners[node] == self._own:
                    held.leave(node)

            with suppress(OSError, ValueError, IndexError, TransportError):
                self._change(change)
            self._file.close()
