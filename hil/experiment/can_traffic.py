"""A CAN bus that takes time, as an experiment file describes it: its bit rates, and what else travels on it."""

from __future__ import annotations

import typing
from typing import Any, Final, Literal

from hil.experiment.table import Seconds, Table, not_negative
from transport.can_bus_model.bit_rates import BitRates
from transport.can_bus_model.bits import BASE_MOST, EXTENDED_MOST
from transport.errors import FieldError
from transport.wire.fields import FD_LENGTHS

CAN_FIELDS: Final = ("bitrate", "dbitrate", "buffer", "control", "bit_error_rate", "traffic", "traffic_file", "recorded")
MOST_TRAFFIC: Final = 2000
_ZERO = typing.cast(Seconds, 0.0)


class TrafficTable(Table, frozen=True, kw_only=True):
    """A message of another node on the bus, sent again and again.

    Args:
        name: of the message; by default its identifier.
        can_id: 11 bits, or 29 where ``extended``.
        period: from one to the next.
        offset: when the first one is due.
        jitter: each is queued later than it is due by up to so much, drawn anew each time.
        length: bytes of data; random bytes, drawn anew each time.
        data: instead, the bytes themselves in hexadecimal.
        extended: identifier of 29 bits.
        fd: CAN FD; with the data bit rate where the bus has one.
        node: name of the node that sends it; by default a node of its own.
    """

    name: str = ""
    can_id: int
    period: Seconds
    offset: Seconds = _ZERO
    jitter: Seconds = _ZERO
    length: int = 8
    data: str | None = None
    extended: bool = False
    fd: bool = False
    node: str = ""

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        most = EXTENDED_MOST if values.get("extended") else BASE_MOST
        if not 0 <= values.get("can_id", 0) <= most:
            bits = 29 if values.get("extended") else 11
            yield f"can_id: {values['can_id']:#x}, expected 0 to {most:#x} ({bits} bits)"
        if not 1e-5 <= values.get("period", 1.0) <= 3600:
            yield f"period: {values['period']:g} s is not between 10 us and 1 h"
        yield from not_negative(values, "offset")
        yield from not_negative(values, "jitter")
        length, data = values.get("length", 8), values.get("data")
        if data is not None:
            try:
                length = len(bytes.fromhex(data))
            except ValueError:
                yield f"data: {data!r:.60}, expected bytes in hexadecimal"
                return
        allowed = FD_LENGTHS if values.get("fd") else tuple(range(9))
        if length not in allowed:
            wanted = f"one of {', '.join(map(str, allowed))}" if values.get("fd") else "0 to 8, or fd = true"
            yield f"{'length' if data is None else 'data'}: {length} bytes, expected {wanted}"

    @property
    def said(self) -> str:
        """Its name, for tables."""
        return self.name or f"{self.can_id:#x}"

    @property
    def sender(self) -> str:
        """The name of the node that sends it."""
        return self.node or self.said


BufferName = Literal["overwritten", "fifo"]


def can_faults_of(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
    """Yield what is wrong with the fields of a medium of kind ``can``, or of another kind that has them."""
    if values.get("kind") != "can":
        for field in CAN_FIELDS:
            if values.get(field) not in (None, (), "", 0.0, "overwritten", True):
                yield f"{field}: for a medium of kind 'can' only"
        return
    if values.get("bitrate") is None:
        yield "bitrate: missing; a CAN bus has one, such as 500000"
    else:
        try:
            BitRates(values["bitrate"], values.get("dbitrate"))
        except FieldError as error:
            yield str(error)
    if not 0.0 <= values.get("bit_error_rate", 0.0) <= 1.0:
        yield f"bit_error_rate: {values['bit_error_rate']:g}, expected a probability"
    if values.get("loss"):
        yield "loss: a CAN bus repeats what was destroyed; set bit_error_rate"
    traffic = values.get("traffic", ())
    if len(traffic) > MOST_TRAFFIC:
        yield f"traffic: {len(traffic)} messages, at most {MOST_TRAFFIC}"
    named: dict[str, int] = {}
    for i, message in enumerate(traffic):
        if named.setdefault(message.said, i) != i:
            yield f"traffic[{i}].name: {message.said!r} is the name of traffic[{named[message.said]}] already"
