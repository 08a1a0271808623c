"""The state of a bus as plain lists and numbers, so that processes that take turns keep one bus in a file."""

from __future__ import annotations

from typing import Any

from transport.can_bus_model.bit_rates import BitRates
from transport.can_bus_model.bus import CanBus, Transmission
from transport.can_bus_model.can_frame import CanFrame
from transport.can_bus_model.node import CanNode, Waiting


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
