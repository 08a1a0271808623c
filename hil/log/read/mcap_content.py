"""What an MCAP file holds, gathered without copying message by message: for reading a run and for recovering one."""

from __future__ import annotations

import struct
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Final

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from hil.log.read.mcap_walk import Budget, DamagedRecord, Record, parse, parse_attachment, unpack_chunk

_MESSAGE_HEAD: Final = struct.Struct("<BQH")
MESSAGE_TIME_AT: Final = 15
MESSAGE_PAYLOAD_AT: Final = 31


@dataclass(slots=True, kw_only=True)
class Content:
    """Records by kind; a message stays whole, framing included (time at byte 15, payload from byte 31).

    Args:
        schemas, channels: by number.
        messages: by number of the channel, in the order of the file; whoever reads on may take them out.
        metadata: by name; a later record of one name replaces an earlier one.
        attachments: by name.
        chunks: chunks that were unpacked.
        budget: how much the file may unpack to.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    messages: defaultdict[int, list[bytes]] = field(default_factory=lambda: defaultdict(list))
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, Attachment] = field(default_factory=dict)
    chunks: int = 0
    budget: Budget

    def take(self, record: Record) -> None:
        """Take one record of the file; indexes and statistics are passed over.

        Raises:
            DamagedRecord: if the record cannot be read; no message of it was taken then.
        """
        if record.opcode == Opcode.CHUNK:
            self._take_chunk(unpack_chunk(record, self.budget), record)
            self.chunks += 1
        elif record.opcode == Opcode.SCHEMA:
            schema = parse(Schema.read, record)
            self.schemas[schema.id] = schema
        elif record.opcode == Opcode.CHANNEL:
            channel = parse(Channel.read, record)
            self.channels[channel.id] = channel
        elif record.opcode == Opcode.METADATA:
            metadata = parse(Metadata.read, record)
            self.metadata[metadata.name] = metadata.metadata
        elif record.opcode == Opcode.ATTACHMENT:
            attachment = parse_attachment(record)
            self.attachments[attachment.name] = attachment
        elif record.opcode == Opcode.MESSAGE:
            whole = struct.pack("<BQ", record.opcode, len(record.body)) + record.body
            self._take_chunk(whole, record)

    def _take_chunk(self, content: bytes, record: Record) -> None:
        messages: defaultdict[int, list[bytes]] = defaultdict(list)
        at, end, head = 0, len(content), _MESSAGE_HEAD.unpack_from
        while at < end:
            try:
                opcode, length, channel = head(content, at)
            except struct.error:
                raise DamagedRecord(f"chunk at byte {record.offset}: ends within a record") from None
            after = at + 9 + length
            if opcode == 0:
                raise DamagedRecord(f"chunk at byte {record.offset}: zeros stand where a record should begin")
            if after > end:
                raise DamagedRecord(f"chunk at byte {record.offset}: a record of {length} bytes exceeds it")
            if opcode == Opcode.MESSAGE:
                if length < MESSAGE_PAYLOAD_AT - 9:
                    raise DamagedRecord(f"chunk at byte {record.offset}: a message of {length} bytes is too short")
                messages[channel].append(content[at:after])
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self.take(Record(record.offset, opcode, memoryview(content)[at + 9 : after]))
            at = after
        for channel, found in messages.items():
            self.messages[channel] += found
