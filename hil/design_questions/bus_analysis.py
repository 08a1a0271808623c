"""How long the messages on a CAN bus may take: their bounds, what a simulation measures beside them, and who delays whom."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.errors import HilError
from hil.experiment.nodes import Medium, TrafficTable
from hil.rig.can_bus import periodic_message, periodic_traffic, rates_of
from transport.can_analysis import ErrorBursts, PeriodicMessage, bus_load, response_times
from transport.can_bus_model import BitRates, Traffic
from transport.can_bus_model.bus import CanBus, Transmission
from transport.can_bus_model.node import CanNode, Waiting

MOST_MESSAGES: Final = 1000
MOST_WAITING: Final = 20_000
"""Frames that an overloaded bus leaves waiting: each of them makes every further one slower."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AnalysedMessage:
    """One message of the table.

    Args:
        name, can_id, extended: which message.
        length: bytes of data.
        frame_ms: its longest frame, with intermission.
        period_ms, deadline_ms: how often it is due, and by when it has to be sent.
        bound_ms: worst-case response time to the end of EOF, None if it has none.
        measured_ms: the worst that the simulation saw, None if it saw none.
        in_time: whether the bound meets the deadline.
        delayed_by: messages that win over it; one frame of any other may block it once.
    """

    name: str
    can_id: int
    extended: bool
    length: int
    frame_ms: float
    period_ms: float
    deadline_ms: float
    bound_ms: float | None
    measured_ms: float | None
    in_time: bool
    delayed_by: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class BusAnalysis:
    """A bus.

    Args:
        name: of the experiment or of the file.
        bitrate, dbitrate: bit/s.
        load: the longest frames over their periods, a share of the bus.
        simulated_s: how long it was simulated.
        messages: by priority.
        assumes: what the bounds hold under, in words.
        disturbed: whether the bus that was simulated has disturbed bits or nodes off the bus that the bounds know nothing of.
    """

    name: str
    bitrate: int
    dbitrate: int | None
    load: float
    simulated_s: float
    messages: tuple[AnalysedMessage, ...]
    assumes: str
    disturbed: bool


def analyse(
    name: str, messages: Sequence[PeriodicMessage], rates: BitRates, measured_ms: Mapping[tuple[bool, int], float | None],
    simulated_s: float, errors: ErrorBursts | None = None, *, disturbed: bool = False,
) -> BusAnalysis:  # fmt: skip
    """Put bounds beside what was measured.

    Args:
        name: for the title.
        messages: all that is sent.
        rates: of the bus.
        measured_ms: the worst response of each, by (extended, identifier).
        simulated_s: how long that took.
        errors: how many errors the bounds allow for.
        disturbed: whether bits are disturbed, or nodes off the bus, in what was measured.

    Raises:
        ValueError: two messages have one identifier.
    """
    found, assumes = [], "no bit is disturbed and no node is off the bus"
    if errors is not None:
        more = f"one more in every {errors.interval_ns / 1e9:g} s"
        assumes = f"errors come at most {errors.burst} at once and {more}, and no node becomes error passive"
    unknown = disturbed and errors is None
    for bound in response_times(messages, rates, errors):
        own, bounded = bound.message, bound.response_ns is not None and not unknown
        found.append(
            AnalysedMessage(
                name=own.name, can_id=own.identifier, extended=own.extended, length=own.length, frame_ms=bound.frame_ns / 1e6,
                period_ms=own.period_ns / 1e6, deadline_ms=own.due_in_ns / 1e6,
                bound_ms=(bound.response_ns or 0) / 1e6 if bounded else None,
                measured_ms=measured_ms.get((own.extended, own.identifier)), in_time=bounded and bound.in_time,
                delayed_by=bound.delayed_by,
            )
        )  # fmt: skip
    load = float(bus_load(messages, rates))
    return BusAnalysis(
        name=name, bitrate=rates.bitrate, dbitrate=rates.dbitrate, load=load, simulated_s=simulated_s, messages=tuple(found),
        assumes=assumes, disturbed=unknown,
    )  # fmt: skip


def analyse_traffic(
    name: str, traffic: Sequence[TrafficTable], rates: BitRates, seconds: float, stream: Callable[[str], np.random.Generator],
    errors: ErrorBursts | None = None,
) -> BusAnalysis:  # fmt: skip
    """Analyse and simulate messages without a rig.

    Args:
        name: for the title.
        traffic: the messages.
        rates: of the bus.
        seconds: how long to simulate.
        stream: returns the random stream of a message, by its name.
        errors: how many errors the bounds allow for; the simulation has none.

    Raises:
        ValueError: two messages have one identifier.
        HilError: more messages, or more frames that would wait, than are simulated.
    """
    if len(traffic) > MOST_MESSAGES:
        raise HilError(f"{name}: {len(traffic)} messages, at most {MOST_MESSAGES}")
    medium = Medium(kind="can", nodes=(), bitrate=rates.bitrate, dbitrate=rates.dbitrate, traffic=tuple(traffic))
    senders = list(dict.fromkeys(message.sender for message in traffic))
    messages = [periodic_message(message, medium) for message in traffic]
    load = float(bus_load(messages, rates))
    left = seconds * sum(1.0 / float(message.period) for message in traffic) * max(0.0, 1.0 - 1.0 / load)
    if left > MOST_WAITING:
        raise HilError(
            f"{name}: the messages need {100.0 * load:.0f} % of the bus, so that {left:.0f} frames would wait in the end, "
            f"at most {MOST_WAITING} are simulated; --duration {seconds * MOST_WAITING / left:.2g}, or fewer messages"
        )
    bus = CanBus(rates_of(medium), [CanNode() for _ in (*senders, "a listener")])
    number = {sender: i for i, sender in enumerate(senders)}
    sources = periodic_traffic(medium, number)
    waiting = Traffic([each.frames(stream(message.said)) for each, message in zip(sources, traffic, strict=True)])
    ended: list[Transmission] = []
    end_ns = round(seconds * 1e9)
    for due in waiting.until(end_ns):
        at = BitRates.units(due.at_ns)
        ended += bus.advance(at)
        bus.queue(due.node, Waiting(due.frame, at))
    ended += bus.advance(BitRates.units(end_ns))
    worst: dict[tuple[bool, int], float | None] = {}
    for each in ended:
        key = (each.waiting.frame.extended, each.waiting.frame.identifier)
        response = BitRates.ns(each.end - each.waiting.queued) / 1e6
        worst[key] = max(worst.get(key) or 0.0, response)
    return analyse(name, messages, rates, worst, seconds, errors)
