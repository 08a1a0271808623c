"""Records on their way into a log, published by name over zenoh too."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from hil.log.records import Channel
from hil.log.write.sinks import PayloadWriter


@contextmanager
def published(
    uri: str | None, channels: Mapping[str, Channel], observers: Mapping[str, PayloadWriter] | None
) -> Iterator[Mapping[str, PayloadWriter] | None]:
    """Give the observers of a session, with those that publish its records where that is asked for.

    Args:
        uri: where subscribers connect, see `transport.links.zenoh_signals`; None to publish nothing.
        channels: the session's table.
        observers: topic to function, of others who look.

    Raises:
        TransportError: nothing can be published there.
    """
    if uri is None:
        yield observers
        return
    from transport.links.zenoh_signals import SignalPublisher

    schemas = {topic: (channel.schema.name, channel.schema.text) for topic, channel in channels.items() if not channel.schema.raw}
    with SignalPublisher(uri, schemas) as publisher:
        yield together(observers or {}, publisher.observers)


def together(first: Mapping[str, PayloadWriter], second: Mapping[str, PayloadWriter]) -> dict[str, PayloadWriter]:
    """Return what hands the records of every topic to both."""
    found = dict(first)
    for topic, put in second.items():
        found[topic] = _both(found[topic], put) if topic in found else put
    return found


def _both(first: PayloadWriter, second: PayloadWriter) -> PayloadWriter:
    def put(t_ns: int, payload: bytes) -> None:
        second(t_ns, payload)
        first(t_ns, payload)

    return put
