"""A log that goes nowhere, written before that of a session: memory for a burst is taken before the run, and not during it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress

from hil.errors import HilError
from hil.log.records import Channel
from hil.log.write.mcap_sink import REAL_FLUSH_BYTES, McapSink
from hil.log.write.pipe_sink import PipeSink
from hil.log.write.provenance import Provenance
from hil.log.write.pump import pump
from hil.log.write.sinks import record_to

FRAME = bytes(64)


def rehearse(channels: Mapping[str, Channel]) -> None:
    """Carry the longest burst through a pipe to a log, as `pump` does it, in this thread.

    Where it cannot (no descriptor is left), the session's memory grows by a burst, and nothing else is lost.

    Args:
        channels: the session's table.
    """
    with suppress(OSError, HilError):
        _rehearse(channels)


def _rehearse(channels: Mapping[str, Channel]) -> None:
    read_fd, write_fd = os.pipe()
    try:
        _burst(write_fd, channels)
        nothing = Provenance(
            experiment="", experiment_text="", resolved={}, seed=0, clock="real", link="", versions={}, commit=""
        )  # fmt: skip
        with McapSink(os.devnull, channels, nothing, now=lambda: 0.0) as sink:
            pump(read_fd, sink, channels)
    finally:
        os.close(read_fd)


def _burst(fd: int, channels: Mapping[str, Channel]) -> None:
    source, length = PipeSink(fd, channels), 0
    try:
        rows = []
        for channel in channels.values():
            schema = channel.schema
            values = [0] * len(schema.codes) + [FRAME] * schema.raw
            rows.append((record_to(source, channel), values, schema.dtype.itemsize + len(FRAME) * schema.raw))
        k = 0
        while length < 2 * REAL_FLUSH_BYTES:
            for put, values, size in rows:
                if put is not None:
                    put(k, values)
                length += size
            source.commit()
            k += 1
    finally:
        source.close()
