"""The reference of the log's writer: every record through `mcap.writer.Writer`, one by one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

from mcap.writer import CompressionType, Writer

from hil.log import encode_event, to_json
from hil.log.records import EVENT_SCHEMA, EVENT_SCHEMA_NAME, EVENTS_TOPIC, Channel
from hil.log.write import PayloadWriter
from hil.log.write.mcap_sink import FLUSH_BYTES, LIBRARY
from hil.log.write.provenance import Provenance


class PlainSink:
    """Writes the file that `McapSink` must write, byte for byte."""

    def __init__(self, path: Path, channels: Mapping[str, Channel], about: Provenance) -> None:
        self._file = open(path, "wb")  # noqa: SIM115
        self._writer = writer = Writer(
            self._file, chunk_size=1 << 62, compression=CompressionType.ZSTD, enable_data_crcs=True
        )
        self._ids: dict[str, int] = {}
        self._open_bytes = self._messages = 0
        writer.start(profile="ros2", library=LIBRARY)
        for name, record in about.metadata().items():
            writer.add_metadata(name, record)
        for name, media_type, data in about.attachments():
            writer.add_attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data)
        schemas: dict[str, int] = {}
        for channel in channels.values():
            schema = channel.schema
            if schema.name not in schemas:
                schemas[schema.name] = writer.register_schema(schema.name, "ros2msg", schema.text.encode())
            self._ids[channel.topic] = writer.register_channel(channel.topic, "cdr", schemas[schema.name])
        events = writer.register_schema(EVENT_SCHEMA_NAME, "ros2msg", EVENT_SCHEMA.encode())
        self._ids[EVENTS_TOPIC] = writer.register_channel(EVENTS_TOPIC, "cdr", events)
        writer.flush()  # type: ignore[no-untyped-call]

    def channel(self, topic: str) -> PayloadWriter | None:
        """See `Sink`."""
        number = self._ids[topic]

        def put(t_ns: int, payload: bytes) -> None:
            t_ns = max(t_ns, 0)
            self._writer.add_message(number, t_ns, payload, t_ns)
            self._messages += 1
            self._open_bytes += len(payload) + 31

        return put

    def event(
        self, t_ns: int, kind: str, message: str, *, slot: int = -1, severity: str = "info", **data: object
    ) -> None:
        """See `Sink`."""
        put = self.channel(EVENTS_TOPIC)
        assert put is not None
        put(t_ns, encode_event(t_ns, kind, message, slot=slot, severity=severity, data=data))

    def commit(self) -> None:
        """See `Sink`."""
        if self._open_bytes >= FLUSH_BYTES:
            self._writer.flush()  # type: ignore[no-untyped-call]
            self._open_bytes = 0

    def __enter__(self) -> PlainSink:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]
        summary = {"log": {"messages": self._messages, "dropped": 0}}
        self._writer.add_metadata("summary", {"json": to_json(summary).decode()})
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()
