"""The MCAP file of a session, written so that a kill costs 100 ms at most and a full disk costs only the log."""

from __future__ import annotations

import errno
import fcntl
import os
import stat
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from hil.errors import HilError, located
from hil.log import to_json
from hil.log.records import EVENT_SCHEMA, EVENT_SCHEMA_NAME, EVENTS_TOPIC, Channel
from hil.log.write import PayloadWriter, Record, Sink
from hil.log.write.mcap_records import layouts
from hil.log.write.mcap_writer import Index, McapWriter
from hil.log.write.open_chunk import ColumnBuffer, Keep
from hil.log.write.provenance import Provenance

LIBRARY: Final = "hilrig"
FLUSH_BYTES: Final = 1 << 16
FLUSH_S: Final = 0.05
REAL_FLUSH_BYTES: Final = 1 << 15
"""In real time, where a burst must not make memory grow."""
MOST_WAITING: Final = 1 << 21
"""Bytes that wait in memory for a flush."""


class McapSink(Sink):
    """Writes records to an MCAP file, chunked and compressed; the file is recoverable at every instant.

    Provenance goes first and is flushed at once. Without ``now`` a chunk ends after a fixed number of bytes, so that
    the same records give the same file; with it also after 50 ms, because a killed process loses its open chunk.

    Args:
        path: file to write.
        channels: the session's table (``hil.log.topics.channels``).
        provenance: what stands before the first record.
        now: monotonic seconds of a clock, in real time only.
        index: how much of an index the file has, see `McapWriter`.
        keep: what is also kept as columns, see `AppendColumn`: topic to the fields of its records, None for all of them.
        replace: whether a file may be replaced that is there and not empty.

    Attributes:
        kept: what was kept of the chunks that were written.
        error: why the log ends early: the file and what the disk said; None while all is written.
        failed_ns: session time of the newest record when the disk refused.
        failed: called once, when the disk takes no more.

    Raises:
        HilError: if the file cannot be created or the first bytes cannot be written; no file is left behind then.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        channels: Mapping[str, Channel],
        provenance: Provenance,
        *,
        now: Callable[[], float] | None = None,
        index: Index = "full",
        keep: Keep | None = None,
        replace: bool = True,
    ) -> None:
        self.path = Path(path)
        self.messages = 0
        self._dropped = 0
        self.error: str | None = None
        self.failed_ns = 0
        self.failed: Callable[[], None] = lambda: None
        self._now = now
        self._flush_bytes = FLUSH_BYTES if now is None else REAL_FLUSH_BYTES
        self._flushed_at = now() if now is not None else 0.0
        self._summary: Mapping[str, Any] = {}
        self._closed = False
        self._ids: dict[str, int] = {}
        self._channels = channels
        self.kept = ColumnBuffer(channels, self._ids, keep or {}, self.path.parent)
        with located(f"log {self.path}: cannot be created", OSError):
            self._disk = _Disk(self.path, replace)
        self._writer = McapWriter(
            self._disk, profile="ros2", library=LIBRARY, index=index, chunk_ended=self.kept.take, folder=self.path.parent,
            room=0 if now is None else 2 * REAL_FLUSH_BYTES,
        )  # fmt: skip
        try:
            self._open(channels, provenance)
        except BaseException as error:
            self._disk.discard()
            if isinstance(error, OSError):
                raise HilError(f"log {self.path}: cannot be written: {error.strerror or error}") from error
            raise

    def _open(self, channels: Mapping[str, Channel], provenance: Provenance) -> None:
        writer = self._writer
        for name, record in provenance.metadata().items():
            writer.add_metadata(name, record)
        for name, media_type, data in provenance.attachments():
            writer.add_attachment(name, media_type, data)
        schemas: dict[str, int] = {}
        for channel in channels.values():
            schema = channel.schema
            if schema.name not in schemas:
                schemas[schema.name] = writer.register_schema(schema.name, "ros2msg", schema.text.encode())
            self._ids[channel.topic] = writer.register_channel(
                channel.topic, "cdr", schemas[schema.name], provenance.channels.get(channel.topic)
            )  # fmt: skip
        events = writer.register_schema(EVENT_SCHEMA_NAME, "ros2msg", EVENT_SCHEMA.encode())
        self._ids[EVENTS_TOPIC] = writer.register_channel(EVENTS_TOPIC, "cdr", events)
        writer.flush()

    def channel(self, topic: str) -> PayloadWriter | None:
        """See ``Sink``; ``/events`` takes payloads that were encoded elsewhere."""
        if topic not in self._ids:
            return None
        return self._writer.messages_of(self._ids[topic])

    def records(self, topics: Sequence[str]) -> Record | None:
        """See ``PacksRecords``."""
        if not set(topics) <= set(self._channels):
            return None
        writer = self._writer
        add = writer.chunk.adds(layouts([(self._ids[topic], self._channels[topic].schema) for topic in topics]))
        return add if self._now is None else lambda t_ns, values: add(writer.start_ns + t_ns, values)

    def begin(self, wall_ns: int) -> None:
        """See ``Dated``; the file says it in the metadata ``clock``."""
        self._writer.start_ns = wall_ns
        self._writer.add_metadata("clock", {"start_ns": str(wall_ns)})

    def behind(self, ns: int) -> None:
        """See ``Dated``."""
        self._writer.behind_ns = ns

    @property
    def dropped(self) -> int:
        """Records that are not in the file."""
        return self._dropped + self._writer.chunk.refused

    def drop(self, records: int) -> None:
        """Count records that were lost on their way here."""
        self._dropped += records

    def commit(self) -> None:
        """See ``Sink``; ends a chunk when it is due."""
        if self._writer.chunk.size >= self._flush_bytes:
            self._flush()
        elif self._now is not None:
            now = self._now()
            if now - self._flushed_at >= FLUSH_S:
                self._flushed_at = now
                if len(self._writer.chunk):
                    self._flush()

    def summary(self, values: Mapping[str, Any]) -> None:
        """Set what ``close`` writes as metadata ``summary`` beside the counters of the log itself."""
        self._summary = values

    def close(self) -> None:
        """Write the rest and the index, and close the file; idempotent, never raises for the disk's sake."""
        if self._closed:
            return
        self._flush()
        if self.error is None:
            summary = {**self._summary, "log": {"messages": self.messages, "dropped": self.dropped}}
            try:
                self._writer.add_metadata("summary", {"json": to_json(summary).decode()})
                self._writer.finish()
                self._disk.flush()
            except OSError as error:
                self._fail(error)
        self._closed = True
        self._writer.chunk.closed = True
        self._disk.close()

    def discard(self) -> None:
        """Close the file and leave none behind; a device stays."""
        self.close()
        self._disk.discard()

    def reader(self) -> int:
        """Return a descriptor of the file for reading it back, whatever becomes of its name; the caller closes it.

        Raises:
            HilError: no descriptor is available.
        """
        with located(f"log {self.path}: cannot be read back", OSError):
            return self._disk.duplicate()

    def gone(self) -> str | None:
        """Return what happened to the file's name while the log was open, None if it still names the log."""
        return self._disk.gone()

    def _flush(self) -> None:
        if self.error is not None or self._closed:
            return
        messages = len(self._writer.chunk)
        try:
            self._writer.flush()
        except OSError as error:
            self._fail(error, messages)
        else:
            self.messages += messages

    def _fail(self, error: OSError, messages: int = 0) -> None:
        self._dropped += messages
        self._writer.chunk.closed = True
        self.failed_ns = self._writer.end_ns
        self.error = f"{self.path}: {error.strerror or error}"
        self.failed()

    def __enter__(self) -> McapSink:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _alone(path: Path, replace: bool) -> int:
    """Open a file, empty; no other run may write it until it is closed.

    Raises:
        OSError: it is a symbolic link, another run writes it, it may not be replaced, or it cannot be opened.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    try:
        if stat.S_ISREG(os.fstat(descriptor).st_mode):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not replace and os.fstat(descriptor).st_size:
                raise FileExistsError(errno.EEXIST, "another run has written it meanwhile")
            os.ftruncate(descriptor, 0)
    except OSError as error:
        os.close(descriptor)
        raise OSError(error.errno, "another run is writing it") if isinstance(error, BlockingIOError) else error from None
    return descriptor


class _Disk:
    """A file that grows by whole flushes: after a failed one it is cut back to the end of the last good one.

    What is large goes to the disk before it is flushed, and is cut off all the same if the rest does not follow.
    """

    def __init__(self, path: Path, replace: bool) -> None:
        self._path = path
        self._file = open(_alone(path, replace), "w+b", buffering=0)  # noqa: SIM115
        self._parts: list[bytes] = []
        self._waiting = 0  # bytes in the parts
        self._position = 0
        self._good = 0

    def write(self, data: bytes) -> int:
        self._parts.append(data)
        self._position += len(data)
        self._waiting += len(data)
        if self._waiting >= MOST_WAITING:
            self._let_go()
        return len(data)

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        self._let_go()
        self._good = self._position

    def _let_go(self) -> None:
        data = memoryview(b"".join(self._parts))
        self._parts.clear()
        self._waiting = 0
        try:
            while data:
                data = data[self._file.write(data) or 0 :]
        except OSError:
            try:
                self._file.truncate(self._good)
            except OSError:
                pass  # a device or a dying disk; the torn end can still be recovered
            raise

    def duplicate(self) -> int:
        return os.dup(self._file.fileno())

    def gone(self) -> str | None:
        status = os.fstat(self._file.fileno())
        if status.st_nlink == 0:
            return "was removed during the run: the measurements of this session are lost"
        try:
            if not os.path.samestat(status, os.stat(self._path)):
                return "was replaced by another file while the log was written; the log has another name now"
        except OSError:
            return "was renamed while the log was written; the log has another name now"
        return None

    def close(self) -> None:
        try:
            self._file.close()
        except OSError:
            pass  # nothing is buffered here; the bytes were taken or refused at flush

    def discard(self) -> None:
        self.close()
        if self._path.is_file():
            self._path.unlink(missing_ok=True)
