"""A channel of the `hil` bus, joined by the options of its URI, or of ``can.Bus``: python-can is not needed.

A link of ours takes its frames as they are, see `transport.links.hil_frames`; for others `transport.links.can_bus` makes
messages of python-can of them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from transport.errors import FieldError
from transport.links.can_datagram import EXTENDED, ID_MASK
from transport.links.hil_frames import HilFrames
from transport.links.link import TransportError
from transport.links.mesh_peer import bus_directory
from transport.links.timed_sender import restart, timed_rates

_CHANNEL = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,31}")


def join_channel(
    name: str, *, fd: bool = True, receive_own_messages: bool = False, timed: object = False, bitrate: object = None,
    dbitrate: object = None, data_bitrate: object = None, berr_reporting: object = False, restart_ms: object = None,
    sample_point: object = None, data_sample_point: object = None,
) -> HilFrames:  # fmt: skip
    """Join a channel.

    Args:
        name: of the channel.
        fd, receive_own_messages, timed, bitrate, dbitrate, data_bitrate, berr_reporting, restart_ms: see
            `transport.links.can_bus.HilBus`.
        sample_point, data_sample_point: taken and ignored.

    Raises:
        TransportError: the name or a rate is not allowed, or the directory cannot be had.
    """
    if not _CHANNEL.fullmatch(name):
        raise TransportError(f"hil: channel {name!r}: expected up to 32 letters, digits, '_', '-', '.'")
    try:
        return HilFrames(
            bus_directory() / name, f"hil channel '{name}'", fd=fd, own=receive_own_messages, bus_errors=bool(berr_reporting),
            rates=timed_rates(timed, bitrate, dbitrate if data_bitrate is None else data_bitrate), restart_s=restart(restart_ms),
        )  # fmt: skip
    except (FieldError, TransportError, OSError) as error:
        raise TransportError(f"hil: channel {name!r}: {error}") from error


def matches_of(filters: Iterable[Mapping[str, Any]]) -> tuple[tuple[int, int], ...]:
    """Return acceptance filters, as python-can writes them, as pairs of identifier and mask with the flags of <linux/can.h>.

    Args:
        filters: ``can_id`` and ``can_mask`` of each, and whether it is of ``extended`` identifiers.
    """
    matches = []
    for rule in filters:
        can_id, mask = rule["can_id"] & ID_MASK, rule["can_mask"] & ID_MASK
        if "extended" in rule:
            can_id |= EXTENDED if rule["extended"] else 0
            mask |= EXTENDED
        matches.append((can_id, mask))
    return tuple(matches)
