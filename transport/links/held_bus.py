"""The bus of several processes while one of them holds it: who is on it, what they have yet to learn, and what is wrong with it.

It is read from the bytes of a file, and written back as bytes.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from time import monotonic_ns
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from msgspec import Struct, field
from msgspec.json import Decoder, encode

from transport.can_bus_model import BitRates, CanFrame
from transport.can_bus_model.bus import CanBus, Memory, Transmission
from transport.can_bus_model.disturbances import BusFault, PlannedErrors, PlannedOutages
from transport.can_bus_model.node import BufferKind, CanNode, State, Waiting
from transport.links import TransportError
from transport.links.private_directory import namespace

PATIENCE_NS: Final = 100_000_000
_MOST_FAILURES: Final = 32
"""So many destroyed frames wait for their sender to look; of more the oldest are forgotten."""


class Ended(NamedTuple):
    """What has become of a frame of one's own.

    Attributes:
        tag: number that its sender gave it.
        end_ns: end of its EOF or error delimiter, CLOCK_MONOTONIC.
        error_bit: None if it got through; otherwise where it was destroyed, and it is sent again.
        alone: False where another participant sent it at once, the very same frame or one with its identifier: that one hands
            it out.
    """

    tag: int
    end_ns: int
    error_bit: int | None
    alone: bool


class StateChange(NamedTuple):
    """A change of one's own error state.

    Attributes:
        at_ns: when, CLOCK_MONOTONIC.
        state: the new one.
        tec, rec: error counters.
    """

    at_ns: int
    state: State
    tec: int
    rec: int


class Participant(Struct, kw_only=True, array_like=True):
    """Whose a node is, and what its owner has yet to learn.

    Attributes:
        owner: a random number and the number of its process, 0 where it has left.
        mail: what became of its frames, and was not handed out yet.
        changes: of its error state, likewise.
        tag, identifier: of the frame that it queued last.
    """

    owner: int = 0
    mail: list[Ended] = field(default_factory=list)
    changes: list[StateChange] = field(default_factory=list)
    tag: int = 0
    identifier: int = -1


_Fault: TypeAlias = tuple[int, int, float | None, int | None, tuple[int, ...]]  # see `BusFault`
_Frame: TypeAlias = tuple[CanFrame, int, int, int, int]  # queued, tag, lost, attempts
_Node: TypeAlias = tuple[BufferKind, bool, BitRates | None, tuple[int, int, int], list[_Frame]]
_Sending: TypeAlias = tuple[int, int, int, int | None, list[tuple[int, int | None, _Frame]]]
SavedBus: TypeAlias = tuple[BitRates, Memory, list[_Node], list[_Sending]]

_DECODER: Final = Decoder(tuple[
    SavedBus, list[Participant], tuple[list[_Fault], list[int], list[int]], list[_Fault], tuple[int, int], str
])  # fmt: skip
"""Of what stands in the file: bus, participants, outages, faults, state of the stream of the disturbed bits, whose clock."""


class HeldBus:
    """The bus while the lock is held.

    Args:
        text: the state, as `text` returned it; anything else is no bus.

    Attributes:
        bus: None if there is none yet.
        participants: of each node.
        clock: time namespace of who began it.
    """

    def __init__(self, text: bytes) -> None:
        self.bus: CanBus | None = None
        self.participants: list[Participant] = []
        self._outages = PlannedOutages()
        self._faults: list[BusFault] = []
        self._drawn = 0, 1
        self.clock = ""
        with suppress(ValueError, IndexError):  # a file that holds none begins a new one
            state, self.participants, outages, faults, self._drawn, self.clock = _DECODER.decode(text)
            self._outages.remember(*outages)
            self._faults = [BusFault(*each) for each in faults]
            self.bus = restored(state)
        self._changed: set[int] = set()
        self._noise: np.random.PCG64 | None = None
        if self.bus is not None:
            self._listen(self.bus)

    def _listen(self, bus: CanBus) -> None:
        """Have the bus disturb what is planned, and say whose state has changed."""
        bus.status = partial(self._note, bus)
        if self._faults:
            self._noise = np.random.PCG64(0)
            state, increment = self._drawn
            self._noise.state = {**self._noise.state, "state": {"state": state, "inc": increment}}
            errors = PlannedErrors(None, np.random.Generator(self._noise))
            errors.plan(self._faults)
            bus.noise = errors

    def _note(self, bus: CanBus, at: int, node: int) -> None:
        own, errors = self.participants[node], bus.nodes[node].errors
        if own.owner:
            self._changed.add(node)
            if errors.off:
                bus.nodes[node].recovers = False  # until it restarts, or the fault is over
            own.changes.append(StateChange(BitRates.ns(at), errors.state, errors.tec, errors.rec))
            del own.changes[:-_MOST_FAILURES]

    @property
    def living(self) -> CanBus:
        """The bus.

        Raises:
            TransportError: there is none.
        """
        if self.bus is None:
            raise TransportError("the file of the bus was emptied by another program")
        return self.bus

    @property
    def owners(self) -> list[int]:
        """Of each node its owner, 0 where it has left."""
        return [each.owner for each in self.participants]

    def start(self, rates: BitRates) -> None:
        """Begin a bus without nodes, idle from now on."""
        self.participants, self._outages, self._faults, self._noise = [], PlannedOutages(), [], None
        self.bus = CanBus(rates, [], idle=BitRates.units(monotonic_ns()))
        self.clock = namespace("time")
        self._listen(self.bus)

    def join(self, node: CanNode, owner: int) -> int:
        """Take a node onto the bus; return its number."""
        owners = self.owners
        place = self.living.join(node, owners.index(0) if 0 in owners else None)
        self.participants[place : place + 1] = [Participant(owner=owner)]
        return place

    def advance(self, now_ns: int) -> set[int]:
        """Let time pass; return whose state has changed."""
        while (edge := self._outages.next_edge(now_ns)) is not None:
            self._pass(edge)
            self._outages.switch(self.living, edge)
        self._pass(now_ns)
        self._faults = [fault for fault in self._faults if fault.end_ns > now_ns]
        changed, self._changed = self._changed, set()
        return changed

    def _pass(self, ns: int) -> None:
        for each in self.living.advance(BitRates.units(ns), _MOST_FAILURES):
            for i, waiting in ((each.node, each.waiting), *each.others):
                if self.participants[i].owner:
                    mail = self.participants[i].mail
                    mail.append(Ended(waiting.tag, BitRates.ns(each.end), each.error_bit, i == each.node))
                    if each.error_bit is not None and len(mail) > _MOST_FAILURES:
                        del mail[next(at for at, end in enumerate(mail) if end.error_bit is not None)]

    def queue(self, i: int, waiting: Waiting) -> None:
        """Let a frame wait that was not queued before."""
        own = self.participants[i]
        if waiting.tag > own.tag:
            own.tag, own.identifier = waiting.tag, waiting.frame.identifier
            self.living.queue(i, waiting)

    def who_sent(self, identifiers: Sequence[int]) -> tuple[int, ...]:
        """Return who queued one of these identifiers last."""
        return tuple(i for i, each in enumerate(self.participants) if each.owner and each.identifier in identifiers)

    def plan(self, faults: Sequence[BusFault], seed: int, now_ns: int) -> None:
        """Replace what is wrong with the bus from now on."""
        faults = [fault._replace(first_ns=max(fault.first_ns, now_ns)) for fault in faults if fault.end_ns > now_ns]
        self._outages.plan(faults, now_ns)
        self._faults = [each for each in faults if each.rate is not None or each.identifier is not None]
        self._drawn, self._noise = _stream(np.random.PCG64(seed)), None

    def leave(self, i: int) -> None:
        """Take a node off the bus for good."""
        self.living.leave(i)
        self._outages.forget(i)
        self.participants[i] = Participant()

    def sweep(self) -> None:
        """Take those off the bus whose process is gone."""
        for i, owner in enumerate(self.owners):
            if owner and not _alive(owner & 0xFFFFFFFF):
                self.leave(i)

    def due(self, i: int, now_ns: int) -> tuple[list[Ended], bool]:
        """Take what one participant may hand out; return whether more of its own waits for others."""
        own = self.participants[i]
        others = [end.end_ns for each in self.participants if each is not own for end in each.mail if end.error_bit is None]
        first = min((end for end in others if end > now_ns - PATIENCE_NS), default=now_ns)
        mine, own.mail = own.mail, [each for each in own.mail if each.end_ns > first]
        return [each for each in mine if each.end_ns <= first], bool(own.mail)

    def changes_of(self, i: int) -> list[StateChange]:
        """Take the changes of state of one participant."""
        own = self.participants[i]
        changes, own.changes = own.changes, []
        return changes

    def text(self) -> bytes:
        """Return everything as bytes."""
        drawn = self._drawn if self._noise is None else _stream(self._noise)
        return encode((saved(self.living), self.participants, self._outages.memory(), self._faults, drawn, self.clock))


def _stream(noise: np.random.PCG64) -> tuple[int, int]:
    state = noise.state["state"]
    return state["state"], state["inc"]


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def saved(bus: CanBus) -> SavedBus:
    """Return everything that a bus remembers; tags of frames must be plain values.

    >>> restored(saved(CanBus(BitRates(500_000), [CanNode()]))).rates
    BitRates(bitrate=500000, dbitrate=None)
    """
    nodes: list[_Node] = []
    for node in bus.nodes:
        errors = node.errors
        counters = errors.tec, errors.rec, errors.sequences
        nodes.append((node.buffer, node.recovers, node.rates, counters, [_plain(each) for each in node.waiting.frames]))
    sending: list[_Sending] = []
    for now, senders in bus.sending:
        places: list[tuple[int, int | None, _Frame]] = []
        for i, each in senders:
            queue = bus.nodes[i].waiting.frames
            places.append((i, next((place for place, other in enumerate(queue) if other is each), None), _plain(each)))
        sending.append((now.start, now.end, now.idle, now.error_bit, places))
    return bus.rates, bus.memory(), nodes, sending


def restored(state: SavedBus) -> CanBus:
    """Return the bus of which `saved` returned the state.

    Raises:
        IndexError: it is none.
    """
    rates, memory, nodes, sending = state
    made = []
    for buffer, recovers, own_rates, (tec, rec, sequences), waiting in nodes:
        node = CanNode(buffer=buffer, recovers=recovers, rates=own_rates)
        node.errors.tec, node.errors.rec, node.errors.sequences = tec, rec, sequences
        for each in waiting:
            node.waiting.queue(_waiting(each))
        made.append(node)
    bus = CanBus(rates, made)
    now = []
    for start, end, idle, error_bit, places in sending:
        senders = tuple((i, _waiting(each) if place is None else bus.nodes[i].waiting.frames[place]) for i, place, each in places)
        now.append((Transmission(senders[0][0], senders[0][1], start, end, idle, error_bit, senders[1:]), senders))
    bus.remember(memory, now)
    return bus


def _plain(each: Waiting) -> _Frame:
    return each.frame, each.queued, each.tag, each.lost, each.attempts


def _waiting(state: _Frame) -> Waiting:
    frame, queued, tag, lost, attempts = state
    waiting = Waiting(frame, queued, tag)
    waiting.lost, waiting.attempts = lost, attempts
    return waiting
