"""A channel of the `hil` bus, joined by the options of its URI, or of ``can.Bus``: python-can is not needed.

A link of ours takes its frames as they are, see `transport.links.hil_frames`; for others `transport.links.can_bus` makes
messages of python-can of them.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any, Final

from transport.can_bus_model import BitRates
from transport.errors import FieldError
from transport.links.can_datagram import EXTENDED, ID_MASK
from transport.links.hil_frames import HilFrames
from transport.links.link import TransportError
from transport.links.mesh_peer import bus_directory

_MOST_RESTART_MS: Final = 1_000_000
_CHANNEL = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,31}")


def join_channel(
    name: str, *, fd: bool = True, receive_own_messages: bool = False, timed: object = False, bitrate: object = None,
    dbitrate: object = None, data_bitrate: object = None, berr_reporting: object = False, restart_ms: object = None,
    sample_point: object = None, data_sample_point: object = None, stamped: bool = False,
) -> HilFrames:  # fmt: skip
    """Join a channel.

    Args:
        name: of the channel.
        fd, receive_own_messages, timed, bitrate, dbitrate, data_bitrate, berr_reporting, restart_ms: see
            `transport.links.can_bus.HilBus`.
        sample_point, data_sample_point: taken and ignored.
        stamped: see `HilFrames`.

    Raises:
        TransportError: the name or a rate is not allowed, or the directory cannot be had.
    """
    if not _CHANNEL.fullmatch(name):
        raise TransportError(f"hil: channel {name!r}: expected up to 32 letters, digits, '_', '-', '.'")
    try:
        return HilFrames(
            bus_directory() / name, f"hil channel '{name}'", fd=fd, own=receive_own_messages, bus_errors=bool(berr_reporting),
            rates=timed_rates(timed, bitrate, dbitrate if data_bitrate is None else data_bitrate), restart_s=restart(restart_ms),
            stamped=stamped,
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


def rate(said: object, field: str) -> int:
    """Return a bit rate that was written as a number or as text, in bit/s.

    Raises:
        ValueError: it is none.

    >>> rate("500k", "bitrate"), rate("2M", "dbitrate"), rate(125000, "bitrate"), rate("83.333k", "bitrate")
    (500000, 2000000, 125000, 83333)
    """
    text = str(said).strip()
    scale = {"k": 1_000, "M": 1_000_000}.get(text[-1:], 1)
    with suppress(ValueError):
        number = float(text[:-1] if scale > 1 else text) * scale
        if number == round(number) and not isinstance(said, bool):
            return round(number)
    raise FieldError(field, f"{said!r:.40}, expected bit/s such as 500000, 500k or 2M")


def timed_rates(timed: object, bitrate: object, dbitrate: object) -> BitRates | None:
    """Return the rates of a bus that takes time, None for one that does not; a rate that times nothing is warned of.

    Raises:
        ValueError: a rate that no controller has, or none.
    """
    if timed in (False, 0, None):
        if bitrate is not None:
            warnings.warn("hil: bitrate times nothing on this bus; add timed=True for a bus that takes time", stacklevel=3)
        return None
    if timed is not True and timed != 1:
        raise FieldError("timed", f"{timed!r:.40}, expected True or False")
    if bitrate is None:
        raise FieldError("bitrate", "missing; a bus that takes time has one, such as 500k")
    return BitRates(rate(bitrate, "bitrate"), None if dbitrate is None else rate(dbitrate, "dbitrate"))


def restart(said: object) -> float | None:
    """Return from bus-off to when recovery begins, s; None for never.

    Raises:
        ValueError: no time.

    >>> restart(100), restart("0"), restart(None)
    (0.1, None, None)
    """
    with suppress(ValueError):
        number = float(str(said)) if said is not None and not isinstance(said, bool) else 0.0
        if 0 <= number <= _MOST_RESTART_MS:
            return number / 1000 or None
    raise FieldError("restart_ms", f"{said!r:.40}, expected milliseconds, 0 to {_MOST_RESTART_MS}; 0: it stays off the bus")
