"""Rebuild an indexed log from one whose writer was killed, whose disk was full, or whose bytes were damaged."""

from __future__ import annotations

import os
import struct
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

from mcap.opcode import Opcode
from mcap.records import Header, MessageIndex, Metadata
from msgspec import Struct, field

from hil.errors import HilError
from hil.files import written_whole
from hil.log.read import mcap_walk
from hil.log.read.mcap_file import Content, open_mcap, start_instant
from hil.log.read.mcap_walk import DamagedRecord, Record
from hil.log.write.mcap_sink import FLUSH_BYTES
from hil.log.write.mcap_writer import McapWriter


class Recovery(Struct, kw_only=True):
    """What was saved and what was not.

    Args:
        messages, chunks, attachments, metadata: what was kept.
        last_ns: log time of the last message that was kept, -1 if there is none.
        start_ns: log time of session time 0.
        closed: whether the file had been closed in good order.
        lost_messages: messages of damaged chunks, as far as the file's own index can tell.
        lost_bytes: bytes behind the tear.
        losses: one line for each.
        checksums: those of the whole file that do not match.
    """

    messages: int = 0
    chunks: int = 0
    attachments: int = 0
    metadata: int = 0
    last_ns: int = -1
    start_ns: int = 0
    closed: bool = False
    lost_messages: int = 0
    lost_bytes: int = 0
    losses: list[str] = field(default_factory=list)
    checksums: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        """For people, one line each."""
        until = f", up to {(self.last_ns - self.start_ns) / 1e9:.3f} s of session time" if self.messages else ""
        chunks = "1 chunk" if self.chunks == 1 else f"{self.chunks} chunks"
        lines = [f"kept: {self.messages} messages in {chunks}{until}; {self.metadata} metadata records,"
                 f" {self.attachments} attachments"]
        lines += [f"lost: {loss}" for loss in self.losses]
        if not self.closed:
            lines.append("lost: the summary and whatever was not on the disk yet (100 ms at most in real time)")
            lines.append("unchecked: metadata, schemas and channels; their checksum stands at a log's end")
        elif not self.losses:
            lines.append("lost: nothing")
        return "\n".join(lines)


def recover(source: str | os.PathLike[str], target: str | os.PathLike[str]) -> Recovery:
    """Write a whole, indexed file with everything of ``source`` that can be read; ``source`` stays as it is.

    Args:
        source: a torn or damaged MCAP file.
        target: the file to write; it must not exist.

    Returns:
        What was kept and what was lost.

    Raises:
        HilError: if ``source`` is no MCAP file, nothing in it can be read, or ``target`` exists or cannot be written.
    """
    source, target = Path(source), Path(target)
    report = Recovery()
    if os.path.lexists(target):
        raise HilError(f"{target}: exists already; name another file with -o")
    with open_mcap(source) as (file, size):
        plan = _Plan(file, size, report)
        if not plan.records:
            raise HilError(f"{source}: nothing can be recovered: {report.losses[0] if report.losses else 'no record'}")
        with written_whole(target, replace=False) as part, open(part, "wb") as out:
            os.fchmod(out.fileno(), os.fstat(file.fileno()).st_mode & 0o777)  # no more readers than the log had
            header = plan.header
            profile, library = (header.profile, header.library) if header else ("", "")
            _rebuild(file, size, plan, McapWriter(out, profile=profile, library=library), report)
    return report


class _Plan:
    """What a first passage through the file finds: schemas and channels, wherever one of their copies can be read."""

    def __init__(self, file: BinaryIO, size: int, report: Recovery) -> None:
        self.records = 0
        self.header: Header | None = None
        self.content = Content(budget=mcap_walk.Budget(size))
        checksums = mcap_walk.Checksums()
        try:
            for record in mcap_walk.walk(file, size):
                self.records += 1
                report.closed = record.opcode == Opcode.FOOTER
                if record.opcode == Opcode.HEADER and self.header is None:
                    self.header = _or_none(Header.read, record)
                with suppress(DamagedRecord):  # said when it is this record's turn
                    self.content.take(record)
                self.content.messages.clear()
                try:
                    checksums.take(record)
                except DamagedRecord as error:
                    report.checksums.append(str(error))
        except mcap_walk.TornFile as error:
            report.closed = False
            report.lost_bytes = size - error.offset
            report.losses.append(f"{report.lost_bytes} bytes, {error}")


def _rebuild(file: BinaryIO, size: int, plan: _Plan, writer: McapWriter, report: Recovery) -> None:
    copy = _Copy(writer, report, plan, mcap_walk.Budget(size))
    damaged = False
    for record in islice(mcap_walk.walk(file, size), plan.records):
        if record.opcode == Opcode.MESSAGE_INDEX and damaged:
            index = _or_none(MessageIndex.read, record)
            report.lost_messages += len(index.records) if index else 0
        elif record.opcode not in (Opcode.MESSAGE_INDEX, Opcode.MESSAGE):
            damaged = False
        try:
            copy.take(record)
        except DamagedRecord as error:
            damaged = record.opcode == Opcode.CHUNK
            report.losses.append(str(error))
    if not report.losses:  # otherwise these say no more than what is said already
        report.losses += [f"{loss}: metadata, schemas or channels may be others than were written" for loss in report.checksums]
    if not copy.ours:
        report.losses.append("the metadata record 'hilrig', without which hil cannot read the new file; other MCAP tools can")
    if report.lost_messages:
        report.losses.append(f"{report.lost_messages} messages stood in damaged chunks")
    writer.add_metadata("recovery", {
        "kept_messages": str(report.messages), "lost_bytes": str(report.lost_bytes),
        "lost_messages": str(report.lost_messages), "losses": "\n".join(report.losses), "closed": str(report.closed),
    })  # fmt: skip
    writer.finish()


class _Copy:
    """Copies record by record, renumbering schemas and channels as mcap's writer wants them."""

    def __init__(self, writer: McapWriter, report: Recovery, plan: _Plan, budget: mcap_walk.Budget) -> None:
        self._writer = writer
        self._report = report
        self._budget = budget
        self._channels: dict[int, int] = {}
        self.ours = False  # whether there is a metadata record of hilrig
        numbers = {0: 0}
        for number, schema in sorted(plan.content.schemas.items()):
            numbers[number] = writer.register_schema(schema.name, schema.encoding, schema.data)
        for number, channel in sorted(plan.content.channels.items()):
            self._channels[number] = writer.register_channel(
                channel.topic, channel.message_encoding, numbers.get(channel.schema_id, 0), channel.metadata
            )

    def take(self, record: Record) -> None:
        writer, report = self._writer, self._report
        if record.opcode == Opcode.CHUNK:
            content = mcap_walk.unpack_chunk(record, self._budget)
            for opcode, channel, at, after in [*mcap_walk.framed(content, record)]:  # all of a chunk, or nothing
                if opcode == Opcode.MESSAGE:
                    self._message(channel, content[at:after])
            report.chunks += 1
            if writer.chunk.size >= FLUSH_BYTES:
                writer.flush()
        elif record.opcode == Opcode.MESSAGE:
            message = struct.pack("<BQ", record.opcode, len(record.body)) + record.body
            for _, channel, _, _ in [*mcap_walk.framed(message, record)]:
                self._message(channel, message)
        elif record.opcode == Opcode.METADATA:
            metadata = mcap_walk.parse(Metadata.read, record)
            writer.add_metadata(metadata.name, metadata.metadata)
            report.metadata += 1
            if metadata.name == "clock":
                report.start_ns = start_instant(metadata.metadata) or 0
            self.ours |= metadata.name == "hilrig"
        elif record.opcode == Opcode.ATTACHMENT:
            found = mcap_walk.parse_attachment(record)
            writer.add_attachment(
                found.name, found.media_type, found.data, create_time=found.create_time, log_time=found.log_time
            )
            report.attachments += 1

    def _message(self, channel: int, message: bytes) -> None:
        number = self._channels.get(channel)
        if number is None:
            self._report.lost_messages += 1
            return
        self._writer.add_framed(number, message)
        self._report.messages += 1
        log_time = int.from_bytes(message[mcap_walk.MESSAGE_TIME_AT : mcap_walk.MESSAGE_TIME_AT + 8], "little")
        self._report.last_ns = max(self._report.last_ns, log_time)


def _or_none(read: Any, record: Record) -> Any:
    try:
        return mcap_walk.parse(read, record)
    except DamagedRecord:
        return None
