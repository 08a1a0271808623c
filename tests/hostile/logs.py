"""Foreign logs: ours, damaged or with other words in it, and a foreign program's."""

from __future__ import annotations

import io
import json
import struct
import tempfile
import zlib
from functools import cache
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from hil.experiment import Experiment, load_experiment
from hil.log import encode_event
from hil.log.read import read_run
from hil.log.read.export import export
from hil.log.read.recover import recover
from hil.log.write.mcap_sink import McapSink
from hil.measure.view import view_of
from hil.pages.run_page import render_report
from hil.session.replay.replay import verify
from tests.hil.log.recording import TABLE, provenance, record

EVENT = {"slot": 0, "t_s": 0.0, "kind": "safety", "severity": "error", "message": "limit", "data": {"scheduler": "x"}}



def write_log(path: Path, words: dict[str, Any]) -> None:
    """Write five slots, and what a log says in words."""
    about = provenance(resolved=words["resolved"], certificate=words["certificate"])
    with McapSink(path, TABLE, about) as sink:
        record(sink, 5)
        put = sink.channel("/events")
        assert put is not None
        for event in words["events"]:
            put(0, _event(event))
        sink.summary(words["summary"] if isinstance(words["summary"], dict) else {"problems": words["summary"]})


def _event(event: Any) -> bytes:
    """Return the payload of an event; of what none can be made, some other bytes."""
    try:
        return encode_event(round(1e9 * event["t_s"]), event["kind"], event["message"], slot=event["slot"],
                            severity=event["severity"], data=event["data"])  # fmt: skip
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError, struct.error):
        return json.dumps(event).encode()


def use_log(path: Path) -> None:
    """Do with a log what the commands do."""
    run = read_run(path)
    view = view_of(run)
    render_report(view)
    export(run, path.with_suffix(".csv"), replace=True)
    verify(run)


@cache
def motor() -> Experiment:
    """The experiment of the logs and sweeps."""
    return load_experiment("dc-motor-hinf")


@cache
def words() -> dict[str, Any]:
    """What stands in words in a log."""
    return {
        "resolved": motor().resolved(),
        "certificate": {"state": "certified", "kind": "mean-square stability", "reason": "radius below 1", "radius": 0.9},
        "events": [EVENT],
        "summary": {"problems": {"x": "y"}},
    }


@cache
def our_log() -> bytes:
    """A log of ours."""
    with tempfile.TemporaryDirectory() as folder:
        write_log(Path(folder) / "x.mcap", words())
        return (Path(folder) / "x.mcap").read_bytes()


@cache
def foreign_log(chunked: bool) -> bytes:
    """The same by a foreign writer, neither packed nor under a checksum: damage reaches what stands in it."""
    out = io.BytesIO()
    writer = Writer(out, compression=CompressionType.NONE, enable_crcs=False, use_chunking=chunked, index_types=IndexType.ALL)
    writer.start(profile="ros2", library="foreign")
    reader = make_reader(io.BytesIO(our_log()))
    for said in reader.iter_metadata():
        writer.add_metadata(said.name, said.metadata)
    for kept in reader.iter_attachments():
        writer.add_attachment(kept.create_time, kept.log_time, kept.name, kept.media_type, kept.data)
    channels: dict[str, int] = {}
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        if channel.topic not in channels:
            assert schema is not None
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, number)
        writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
    writer.finish()
    return out.getvalue()


def read_log(place: Path, data: bytes) -> bool:
    """Read it; one in eight is also recovered, and one in sixteen of those that can be read used as the commands do."""
    path, turn = place / "x.mcap", zlib.crc32(data)
    path.write_bytes(data)
    try:
        for array in read_run(path).arrays.values():
            array.nbytes  # noqa: B018 (what is read when it is asked for is asked for)
        if turn % 16 == 0:
            use_log(path)
    finally:
        if turn % 8 == 0:
            (place / "y.mcap").unlink(missing_ok=True)
            recover(path, place / "y.mcap")
    return True
