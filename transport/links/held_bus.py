"""The bus of several processes while one of them holds it: who is on it, what they have yet to learn, and what is wrong with it.

It is read from the bytes of a file, and written back as bytes.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from time import monotonic_ns
from typing import Any, Final, NamedTuple

import numpy as np

from transport.can_bus_model import BitRates, CanFrame
from transport.can_bus_model.bus import CanBus, Transmission
from transport.can_bus_model.disturbances import BusFault, PlannedErrors, PlannedOutages
from transport.can_bus_model.node import CanNode, State, Waiting
from transport.links import TransportError

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


class HeldBus:
    """The bus while the lock is held.

    Args:
        text: the state, as `text` returned it; anything else is no bus.

    Attributes:
        bus: None if there is none yet.
        owners: of each node a random number and the number of its process, 0 where it has left.
        mail: of each node what became of its frames, and was not handed out yet.
    """

    def __init__(self, text: bytes) -> None:
        self.bus: CanBus | None = None
        self.owners: list[int] = []
        self.mail: list[list[Any]] = []
        self._changes: list[list[Any]] = []
        self._last: list[list[Any]] = []  # of each node the tag and the identifier of the frame that it queued last
        self._outages = PlannedOutages()
        self._faults: list[list[Any]] = []
        self._drawn = [0, 1]  # state of the stream of the disturbed bits
        with suppress(ValueError, TypeError, IndexError, KeyError):  # a file that holds none begins a new one
            state, self.owners, self.mail, self._changes, self._last, outages, self._faults, self._drawn = json.loads(text)
            self._outages.remember(outages)
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
            errors.plan([BusFault(*each) for each in self._faults])
            bus.noise = errors

    def _note(self, bus: CanBus, at: int, node: int) -> None:
        if self.owners[node]:
            self._changed.add(node)
            errors = bus.nodes[node].errors
            if errors.off:
                bus.nodes[node].recovers = False  # until it restarts, or the fault is over
            changes = self._changes[node]
            changes.append([BitRates.ns(at), errors.state, errors.tec, errors.rec])
            del changes[:-_MOST_FAILURES]

    @property
    def living(self) -> CanBus:
        """The bus.

        Raises:
            TransportError: there is none.
        """
        if self.bus is None:
            raise TransportError("the file of the bus was emptied by another program")
        return self.bus

    def start(self, rates: BitRates) -> None:
        """Begin a bus without nodes, idle from now on."""
        self.owners, self.mail, self._changes, self._last = [], [], [], []
        self._outages, self._faults, self._noise = PlannedOutages(), [], None
        self.bus = CanBus(rates, [], idle=BitRates.units(monotonic_ns()))
        self._listen(self.bus)

    def join(self, node: CanNode, owner: int) -> int:
        """Take a node onto the bus; return its number."""
        place = self.living.join(node, self.owners.index(0) if 0 in self.owners else None)
        self.owners[place : place + 1] = [owner]
        for of_nodes, fresh in ((self.mail, []), (self._changes, []), (self._last, [0, -1])):
            of_nodes[place : place + 1] = [fresh]
        return place

    def advance(self, now_ns: int) -> set[int]:
        """Let time pass; return whose state has changed."""
        while (edge := self._outages.next_edge(now_ns)) is not None:
            self._pass(edge)
            self._outages.switch(self.living, edge)
        self._pass(now_ns)
        self._faults = [fault for fault in self._faults if fault[1] > now_ns]
        changed, self._changed = self._changed, set()
        return changed

    def _pass(self, ns: int) -> None:
        for each in self.living.advance(BitRates.units(ns), _MOST_FAILURES):
            for i, waiting in ((each.node, each.waiting), *each.others):
                if self.owners[i]:
                    mail = self.mail[i]
                    mail.append([waiting.tag, BitRates.ns(each.end), each.error_bit, i == each.node])
                    if each.error_bit is not None and len(mail) > _MOST_FAILURES:
                        del mail[next(i for i, (_, _, bit, _) in enumerate(mail) if bit is not None)]

    def queue(self, i: int, waiting: Waiting) -> None:
        """Let a frame wait that was not queued before."""
        if waiting.tag > self._last[i][0]:
            self._last[i] = [waiting.tag, waiting.frame.identifier]
            self.living.queue(i, waiting)

    def who_sent(self, identifiers: Sequence[int]) -> tuple[int, ...]:
        """Return who queued one of these identifiers last."""
        return tuple(i for i, (_, last) in enumerate(self._last) if self.owners[i] and last in identifiers)

    def plan(self, faults: Sequence[BusFault], seed: int, now_ns: int) -> None:
        """Replace what is wrong with the bus from now on."""
        faults = [fault._replace(first_ns=max(fault.first_ns, now_ns)) for fault in faults if fault.end_ns > now_ns]
        self._outages.plan(faults, now_ns)
        self._faults = [list(each) for each in faults if each.rate is not None or each.identifier is not None]
        state = np.random.PCG64(seed).state["state"]
        self._drawn, self._noise = [state["state"], state["inc"]], None

    def leave(self, i: int) -> None:
        """Take a node off the bus for good."""
        self.living.leave(i)
        self._outages.forget(i)
        self.owners[i], self.mail[i], self._changes[i] = 0, [], []

    def sweep(self) -> None:
        """Take those off the bus whose process is gone."""
        for i, owner in enumerate(self.owners):
            if owner and not _alive(owner & 0xFFFFFFFF):
                self.leave(i)

    def due(self, i: int, now_ns: int) -> tuple[list[Ended], bool]:
        """Take what one participant may hand out; return whether more of its own waits for others."""
        others = [end for j, mail in enumerate(self.mail) for _, end, bit, _ in mail if j != i and bit is None]
        first = min((end for end in others if end > now_ns - PATIENCE_NS), default=now_ns)
        mine = [Ended(*each) for each in self.mail[i]]
        self.mail[i] = [list(each) for each in mine if each.end_ns > first]
        return [each for each in mine if each.end_ns <= first], bool(self.mail[i])

    def changes_of(self, i: int) -> list[StateChange]:
        """Take the changes of state of one participant."""
        changes, self._changes[i] = self._changes[i], []
        return [StateChange(*each) for each in changes]

    def text(self) -> bytes:
        """Return everything as bytes."""
        drawn = self._drawn
        if self._noise is not None:
            state = self._noise.state["state"]
            drawn = [state["state"], state["inc"]]
        wrong = [self._outages.memory(), self._faults, drawn]
        held = [saved(self.living), self.owners, self.mail, self._changes, self._last, *wrong]
        return json.dumps(held, separators=(",", ":")).encode()


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def saved(bus: CanBus) -> list[Any]:
    """Return everything that a bus remembers; tags of frames must be plain values.

    >>> restored(saved(CanBus(BitRates(500_000), [CanNode()]))).rates
    BitRates(bitrate=500000, dbitrate=None)
    """
    nodes = []
    for node in bus.nodes:
        errors, rates = node.errors, node.rates
        own_rates = None if rates is None else [rates.bitrate, rates.dbitrate]
        counters = [errors.tec, errors.rec, errors.sequences]
        nodes.append([node.buffer, node.recovers, own_rates, counters, [_waiting(each) for each in node.waiting.frames]])
    sending = []
    for transmission, senders in bus.sending:
        places = []
        for i, each in senders:
            queue = bus.nodes[i].waiting.frames
            places.append([i, next((place for place, other in enumerate(queue) if other is each), None), _waiting(each)])
        sending.append([transmission.start, transmission.end, transmission.idle, transmission.error_bit, places])
    return [bus.rates.bitrate, bus.rates.dbitrate, bus.memory(), nodes, sending]


def restored(state: list[Any]) -> CanBus:
    """Return the bus of which `saved` returned the state.

    Raises:
        ValueError, TypeError, IndexError, KeyError: it is none.
    """
    bitrate, dbitrate, memory, nodes, sending = state
    made = []
    for buffer, recovers, own_rates, (tec, rec, sequences), waiting in nodes:
        node = CanNode(buffer=buffer, recovers=recovers, rates=None if own_rates is None else BitRates(*own_rates))
        node.errors.tec, node.errors.rec, node.errors.sequences = tec, rec, sequences
        for each in waiting:
            node.waiting.queue(_frame(each))
        made.append(node)
    bus = CanBus(BitRates(bitrate, dbitrate), made)
    now = []
    for start, end, idle, error_bit, places in sending:
        senders = tuple(
            (i, _frame(each) if place is None else bus.nodes[i].waiting.frames[place]) for i, place, each in places
        )  # fmt: skip
        now.append((Transmission(senders[0][0], senders[0][1], start, end, idle, error_bit, senders[1:]), senders))
    bus.remember(memory, now)
    return bus


def _waiting(each: Waiting) -> list[Any]:
    f = each.frame
    flags = [f.extended, f.remote, f.dlc, f.fd, f.bitrate_switch, f.error_state]
    return [f.identifier, f.data.hex(), flags, each.queued, each.tag, each.lost, each.attempts]


def _frame(state: list[Any]) -> Waiting:
    identifier, data, (extended, remote, dlc, fd, switch, error_state), queued, tag, lost, attempts = state
    frame = CanFrame(
        identifier=identifier, data=bytes.fromhex(data), extended=extended, remote=remote, dlc=dlc, fd=fd, bitrate_switch=switch,
        error_state=error_state,
    )  # fmt: skip
    waiting = Waiting(frame, queued, tag)
    waiting.lost, waiting.attempts = lost, attempts
    return waiting
