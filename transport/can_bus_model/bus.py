"""A CAN bus in time: at every idle instant the lowest identifier wins, and a frame lasts as long as its bits.

The rule of the instant: who is queued at the instant at which the bus becomes idle takes part in that arbitration, who is queued
later, by however little, does not. A frame of which a part has been sent is never interrupted.

Not modelled: overload frames, the last bit of EOF disturbed, bits that only some nodes see otherwise, the drift of oscillators.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

from transport.can_bus_model import BitRates
from transport.can_bus_model.bits import INTERMISSION, wire_bits
from transport.can_bus_model.disturbances import Noise, destroyed_bits
from transport.can_bus_model.node import BUS_OFF, RECESSIVE_BITS, RECOVERY_SEQUENCES, SUSPENDED_BITS, CanNode, Waiting, collide

Memory = tuple[int, int, list[int], list[tuple[int, int]]]
"""What a bus remembers: since when it is idle and recessive, who is off, and who does not send before when."""

_MISREAD: Final = 12
"""The bit at which a node with other bit rates has seen what can be no frame: about behind the identifier."""


class Transmission(NamedTuple):
    """A frame that was on the bus.

    Attributes:
        node: who sent it; of several with the very same frame the first.
        waiting: what was sent.
        start: first instant of the start of frame, in units.
        end: end of the EOF, or of the error delimiter.
        idle: when the bus is idle again.
        error_bit: position of the bit at which it was destroyed; None: it got through.
        others: who else sent, with its frame: the very same one, or one with its identifier that collided with it.
    """

    node: int
    waiting: Waiting
    start: int
    end: int
    idle: int
    error_bit: int | None
    others: tuple[tuple[int, Waiting], ...] = ()


class CanBus:
    """Nodes on one wire.

    Args:
        rates: bit rates of all nodes.
        nodes: everyone on the bus, those that only listen and acknowledge included.
        noise: disturbances; None: none.
        idle: first instant at which the bus is idle, in units.
        status: called with (instant, node) when the error state of a node has changed.

    Attributes:
        noise, status: see above; they may be replaced between two calls.
    """

    def __init__(
        self,
        rates: BitRates,
        nodes: Sequence[CanNode],
        noise: Noise | None = None,
        idle: int = 0,
        status: Callable[[int, int], None] = lambda at, node: None,
    ) -> None:
        self.rates, self.nodes = rates, list(nodes)
        self.noise, self.status = noise, status
        self._idle = idle
        self._busy: set[int] = set()  # nodes with frames that wait
        self._not_before: dict[int, int] = {}
        self._off: set[int] = set()
        self._counted = True  # a receive error counter may be above 0
        self._recessive_since = idle - RECESSIVE_BITS * rates.bit
        self._now: list[tuple[Transmission, tuple[tuple[int, Waiting], ...]]] = []  # at most one, with all who send it

    def queue(self, node: int, waiting: Waiting) -> Waiting | None:
        """Let a frame wait, after `advance` to that instant; return the older one whose place it takes.

        An older one that is being sent goes on, and is not sent again if it is destroyed.
        """
        self._busy.add(node)
        old = self.nodes[node].waiting.queue(waiting)
        return None if old is None or self._sending(old) else old

    def _sending(self, waiting: Waiting) -> bool:
        return any(each is waiting for _, senders in self._now for _, each in senders)

    def abort(self, node: int, waiting: Waiting) -> bool:
        """Take out a frame that waits; return False for one that is being sent, or was: it stays."""
        if self._sending(waiting) or not self.nodes[node].waiting.remove(waiting):
            return False
        if not self.nodes[node].waiting:
            self._busy.discard(node)
        return True

    def advance(self, until: int, most: int | None = None) -> list[Transmission]:
        """Let time pass; return what ended, in order, up to that instant and at it.

        Arbitration at that very instant is left for the next call, so that frames queued in it take part.

        Args:
            until: an instant in units, not before the last one.
            most: repeats of a frame that no node acknowledges are left out but for the last so many; None: none is.
        """
        ended: list[Transmission] = []
        while True:
            if self._now:
                if self._now[0][0].end > until:
                    return ended
                ended.append(self._finish(*self._now.pop()))
            start = self._next_start()
            back = self._next_recovery()
            if back is not None and back < until and (start is None or back <= start):
                self._recover(back)
            elif start is None or start >= until:
                return ended
            else:
                self._begin(start)
                if most is not None:
                    self._skip(until, most)

    def _skip(self, until: int, most: int) -> None:
        """Leave out repeats, each of which is as the one that has begun: its sender is alone, error passive, and counts none."""
        done, senders = self._now[0]
        node, waiting = self.nodes[done.node], done.waiting
        alone = len(self.nodes) - len(self._off) == 1 and node.errors.passive and self.noise is None
        if alone and waiting is node.waiting.head() and self._next_recovery() is None:
            period = done.idle + SUSPENDED_BITS * self.rates.bit - done.start
            left_out = max(0, (until - done.end) // period - most)
            waiting.attempts += left_out
            by = left_out * period
            self._now = [(done._replace(start=done.start + by, end=done.end + by, idle=done.idle + by), senders)]

    def _next_start(self) -> int | None:
        best = None
        for node in self._busy - self._off if self._off else self._busy:
            ready = self.nodes[node].waiting.head().queued
            if node in self._not_before:
                ready = max(ready, self._not_before[node])
            if ready <= self._idle:
                return self._idle
            best = ready if best is None else min(ready, best)
        return best

    def _next_recovery(self) -> int | None:
        missing = [RECOVERY_SEQUENCES - self.nodes[i].errors.sequences for i in self._off if self.nodes[i].recovers]
        return self._recessive_since + min(missing) * RECESSIVE_BITS * self.rates.bit if missing else None

    def _recover(self, at: int) -> None:
        sequences = self._sequences(at)
        for i in sorted(self._off):
            errors = self.nodes[i].errors
            if self.nodes[i].recovers and errors.sequences + sequences >= RECOVERY_SEQUENCES:
                errors.recover()
                self._off.discard(i)
                self._not_before[i] = at
                self.status(at, i)

    def _sequences(self, at: int) -> int:
        return (at - self._recessive_since) // (RECESSIVE_BITS * self.rates.bit)

    def _begin(self, start: int) -> None:
        for i in self._off:
            self.nodes[i].errors.sequences += self._sequences(start)
        nodes, held = self.nodes, self._off or self._not_before
        ready = [i for i in self._busy if i not in self._off and self._not_before.get(i, start) <= start] if held else self._busy
        self._not_before.clear()  # who waited so long receives now
        heads = {}
        for i in ready:
            head = nodes[i].waiting.head()
            if head.queued <= start:
                head.lost += 1  # but for those who win
                heads[i] = head
        best = min([head.key for head in heads.values()])
        senders = sorted([i for i, head in heads.items() if head.key == best])
        for i in senders:
            heads[i].lost -= 1
        sent = heads[senders[0]]
        error = None
        if len(senders) > 1:
            wires = [wire_bits(heads[i].frame).bits for i in senders]
            met = collide(wires, [self.nodes[i].errors.passive for i in senders])
            for place in met.fallen:
                self._send_failed(senders[place], start)
            senders, error = [senders[place] for place in met.senders], met.bit
            sent = heads[senders[0]]
        length = sent.bits()
        if error is None and self.noise is not None:
            error = self.noise.first(sum(length) - INTERMISSION - 1, start, sent.frame)
        listeners = len(self.nodes) - len(self._off) - len(senders)
        if error is None and self._disturbed(senders):
            error = _MISREAD
        unanswered = not listeners
        if unanswered and (error is None or error > sum(length) - 12):
            error = sum(length) - 12  # the ACK slot stays recessive
        for i in senders:
            heads[i].attempts += 1
        idle = start + self.rates.duration(length)
        if error is not None:
            active = any(not self.nodes[i].errors.passive for i in senders)
            idle = start + self.rates.duration(destroyed_bits(sent.frame, error, dominant=active, answered=not unanswered))
        all_of_them = tuple((i, heads[i]) for i in senders)
        end = idle - INTERMISSION * self.rates.bit
        self._now.append((Transmission(senders[0], sent, start, end, idle, error, all_of_them[1:]), all_of_them))

    def _disturbed(self, senders: Sequence[int]) -> bool:
        """Return whether a node with other bit rates than the sender's destroys the frame."""
        rates = self.nodes[senders[0]].rates
        return any(
            node.rates != rates and not node.errors.passive and i not in self._off
            for i, node in enumerate(self.nodes) if node.rates is not None or rates is not None
        )  # fmt: skip

    def _send_failed(self, i: int, at: int, *, unanswered: bool = False) -> None:
        node = self.nodes[i]
        before = node.errors.state
        node.errors.send_failed(unanswered=unanswered)
        if node.errors.off:
            self._off.add(i)
            node.errors.sequences = 0
        if node.errors.state != before:
            self.status(at, i)

    def _finish(self, done: Transmission, senders: Sequence[tuple[int, Waiting]]) -> Transmission:
        of = {i for i, _ in senders}
        unanswered = len(self.nodes) - len(self._off) == len(senders)
        self._idle, self._recessive_since = done.idle, done.idle - RECESSIVE_BITS * self.rates.bit
        for i, waiting in senders:
            node, before = self.nodes[i], self.nodes[i].errors.state
            if done.error_bit is None:
                if i not in self._off:  # switched off meanwhile
                    node.errors.sent()
                node.waiting.remove(waiting)
                if node.errors.state != before:
                    self.status(done.end, i)
            else:
                self._send_failed(i, done.end, unanswered=unanswered)
            if not node.waiting:
                self._busy.discard(i)
            if node.errors.passive:
                self._not_before[i] = done.idle + SUSPENDED_BITS * self.rates.bit
        if done.error_bit is None and not self._counted:
            return done
        for i, node in enumerate(self.nodes):
            errors = node.errors
            if i not in of and (done.error_bit is not None or errors.rec) and i not in self._off:
                before = errors.state
                errors.received() if done.error_bit is None else errors.receive_failed()
                if errors.state != before:
                    self.status(done.end, i)
        self._counted = any(node.errors.rec for node in self.nodes)
        return done

    @property
    def sending(self) -> Sequence[tuple[Transmission, tuple[tuple[int, Waiting], ...]]]:
        """What is on the bus, with all who send it: nothing, or one frame."""
        return tuple(self._now)

    def next_instant(self) -> int | None:
        """Return when something happens next by itself, in units; None if nothing does."""
        if self._now:
            return self._now[0][0].end
        instants = [each for each in (self._next_start(), self._next_recovery()) if each is not None]
        return min(instants, default=None)

    def join(self, node: CanNode, place: int | None = None) -> int:
        """Take a node onto the bus, in the place of one that left where given; return its number."""
        if place is None:
            self.nodes.append(node)
            return len(self.nodes) - 1
        self.nodes[place] = node
        self._off.discard(place)
        self._not_before.pop(place, None)
        return place

    def leave(self, i: int) -> None:
        """Take a node off the bus for good: what it sends now ends, and nothing more of it is received."""
        self.nodes[i] = CanNode(recovers=False)
        self._off.add(i)
        self._busy.discard(i)

    def switch_off(self, i: int, at: int) -> None:
        """Take a node off the bus, as bus-off does, until `switch_on`; what it sends at that instant ends, what waits stays.

        Args:
            i: the node.
            at: an instant up to which the bus was advanced, in units.
        """
        node = self.nodes[i]
        node.errors.tec, node.recovers = max(node.errors.tec, BUS_OFF), False
        self._off.add(i)
        self.status(at, i)

    def switch_on(self, i: int, at: int) -> None:
        """Let a node that was switched off come back, after 128 times 11 recessive bits from now on; see `switch_off`."""
        node = self.nodes[i]
        node.recovers, node.errors.sequences = True, -self._sequences(at)

    def memory(self) -> Memory:
        """Return what it remembers besides its nodes and what is being sent."""
        return self._idle, self._recessive_since, sorted(self._off), sorted(self._not_before.items())

    def remember(self, memory: Memory, now: Sequence[tuple[Transmission, tuple[tuple[int, Waiting], ...]]]) -> None:
        """Take over what `memory` returned, and what is being sent."""
        self._idle, self._recessive_since, off, not_before = memory
        self._counted = True
        self._off, self._not_before, self._now = set(off), dict(not_before), list(now)
        self._busy = {i for i, node in enumerate(self.nodes) if node.waiting}
