"""Writing a log: sinks, the pipe out of a process that keeps time, the MCAP file.

A sink is where a session's records go; here are its protocol, and the sinks that keep records in memory. A loop asks once for the
function of every topic, calls it with time and payload, and commits once per slot. No sink ever raises into the loop: what it
cannot keep it counts.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Protocol, runtime_checkable

from hil.log import encode_event
from hil.log.records import EVENTS_TOPIC, Channel

PayloadWriter = Callable[[int, bytes], None]
"""Takes the nominal session time in ns and the payload of one record."""


Record = Callable[[int, Sequence[Any]], None]
"""Takes the nominal session time in ns, and the fields of a record, or of several, one behind the other."""


class Sink(Protocol):
    """Takes a session's records."""

    def channel(self, topic: str) -> PayloadWriter | None:
        """Function that takes the records of ``topic``; None if they are not kept, so that they are not packed."""

    def event(self, t_ns: int, kind: str, message: str, *, slot: int = -1, severity: str = "info", **data: object) -> None:
        """Take an event, as a record of ``/events``."""
        put = self.channel(EVENTS_TOPIC)
        if put is not None:
            put(t_ns, encode_event(t_ns, kind, message, slot=slot, severity=severity, data=data))

    def commit(self) -> None:
        """Close the slot: everything since the last commit may now leave."""


@runtime_checkable
class PacksRecords(Protocol):
    """A sink that packs the numbers of records itself, quicker than it takes bytes."""

    def records(self, topics: Sequence[str]) -> Record | None:
        """Function that takes the fields of one record of each topic, in order; None if it does not take all."""


@runtime_checkable
class Dated(Protocol):
    """A sink that says when records happened, by the clock on the wall: in real time."""

    def begin(self, wall_ns: int) -> None:
        """Say when session time 0 was, in ns since 1970; once, before the first record."""

    def behind(self, ns: int) -> None:
        """Say how much after its nominal time happened what is recorded next, ns."""


def record_to(sink: Sink, channel: Channel) -> Record | None:
    """Return the function that logs a record of a topic; None if they are not kept."""
    if isinstance(sink, PacksRecords):
        return sink.records((channel.topic,))
    put, pack = sink.channel(channel.topic), channel.schema.pack
    return None if put is None else lambda t_ns, values: put(t_ns, pack(*values))


def records_to(sink: Sink, topics: Sequence[str]) -> Record | None:
    """Return the function that logs one record of each topic at once; None where they have to be logged one by one."""
    return sink.records(topics) if isinstance(sink, PacksRecords) else None


class MemorySink(Sink):
    """Keeps records in memory, for sweeps, tests and summaries.

    Args:
        channels: the session's table (``hil.log.topics.channels``).
        topics: topics to keep, all if None; ``/events`` is one of them.
    """

    def __init__(self, channels: Mapping[str, Channel], topics: Collection[str] | None = None) -> None:
        unknown = set(topics or ()) - set(channels) - {EVENTS_TOPIC}
        if unknown:
            raise ValueError(f"topics: {min(unknown)!r} is not in the table of channels")
        self.channels = channels
        self.times: dict[str, list[int]] = {}
        self.payloads: dict[str, list[bytes]] = {}
        for topic in (*channels, EVENTS_TOPIC):
            if topics is None or topic in topics:
                self.times[topic], self.payloads[topic] = [], []

    def channel(self, topic: str) -> PayloadWriter | None:
        """See ``Sink``."""
        if topic not in self.times:
            return None
        keep_time, keep = self.times[topic].append, self.payloads[topic].append

        def put(t_ns: int, payload: bytes) -> None:
            keep_time(t_ns)
            keep(payload)

        return put

    def commit(self) -> None:
        """See ``Sink``."""


class TeeSink(Sink):
    """Gives every record to a sink, and to the observers of its topic.

    Args:
        sink: keeps the records.
        observers: each gets time and payload of its topic's records, for a live view.
    """

    def __init__(self, sink: Sink, observers: Mapping[str, PayloadWriter]) -> None:
        self._observers = observers
        self._sink = sink

    def channel(self, topic: str) -> PayloadWriter | None:
        """See ``Sink``."""
        put, look = self._sink.channel(topic), self._observers.get(topic)
        return put or look if put is None or look is None else both(look, put)

    def commit(self) -> None:
        """See ``Sink``."""
        self._sink.commit()


@contextmanager
def published(
    uri: str | None, channels: Mapping[str, Channel], observers: Mapping[str, PayloadWriter]
) -> Iterator[Mapping[str, PayloadWriter]]:
    """Give the observers of a session, with those that publish its records where that is asked for.

    Args:
        uri: where subscribers connect, see `transport.links.zenoh_observers`; None to publish nothing.
        channels: the session's table.
        observers: topic to function, of others who look.

    Raises:
        TransportError: nothing can be published there.
    """
    if uri is None:
        yield observers
        return
    from transport.links.zenoh_observers import SignalPublisher

    schemas = {topic: (channel.schema.name, channel.schema.text) for topic, channel in channels.items() if not channel.schema.raw}
    with SignalPublisher(uri, schemas) as publisher:
        yield together(observers, publisher.observers)


def harmless(observers: Mapping[str, PayloadWriter], sink: Sink) -> dict[str, PayloadWriter]:
    """Return observers that a run never fails by: one that raises is taken off, and an event of the log says so.

    Args:
        observers: topic to what gets time and payload of its records.
        sink: takes the event.
    """
    return {topic: _taken_off(topic, look, sink) for topic, look in observers.items()}


def _taken_off(topic: str, look: PayloadWriter, sink: Sink) -> PayloadWriter:
    on = True

    def put(t_ns: int, payload: bytes) -> None:
        nonlocal on
        if on:
            try:
                look(t_ns, payload)
            except Exception as error:  # whatever a view does
                on = False
                message = f"a view gets no more records of {topic}: {type(error).__name__}: {error}"
                sink.event(t_ns, "view failed", message, severity="warning")

    return put


def together(first: Mapping[str, PayloadWriter], second: Mapping[str, PayloadWriter]) -> dict[str, PayloadWriter]:
    """Return what hands the records of every topic to both."""
    found = dict(first)
    for topic, put in second.items():
        found[topic] = both(found[topic], put) if topic in found else put
    return found


def both(first: PayloadWriter, second: PayloadWriter) -> PayloadWriter:
    """Return what hands a record to the second, then to the first."""

    def put(t_ns: int, payload: bytes) -> None:
        second(t_ns, payload)
        first(t_ns, payload)

    return put
