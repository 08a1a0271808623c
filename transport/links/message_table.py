"""Which signals of a database (DBC) the values of a rig are, for a controller that keeps the CAN messages it has.

====================== =============================================================================================
option of a link's URI says
====================== =============================================================================================
``dbc=motor.dbc``      the database
``outputs=M.Angle``    MESSAGE.SIGNAL of each measured output in its order, an empty one is not sent; nodes apart by ``;``
``references=M.Set``   likewise of the references
``inputs=C.Voltage``   of each input, in messages that the controller sends
``counters=M.Alive``   signals that count the frames of their message
``valid=0.05``         s for which a command stands: the newest one answers at once
====================== =============================================================================================

``M.Angle*57.3`` multiplies: the signal is 57.3 times what the rig has. ``M.Angle:rad`` says the rig's unit, which has to be the
database's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, Final

from msgspec import Struct

from transport.dbc import check_places, read_dbc
from transport.errors import FieldError, nearest
from transport.links import TransportError
from transport.links.can_datagram import EXTENDED, ID_MASK
from transport.links.can_identifiers import LARGEST
from transport.links.private_directory import read_bounded

_LARGEST_DBC: Final = 16_000_000
_LONGEST_VALID_S: Final = 60.0
_REAL: Final = {16: 65504.0, 32: 3.4028234e38, 64: 1.7976931e308}
"""Largest floating-point number, by bits."""
_PER_UNIT: Final = {
    ("rad", "deg"): 180 / math.pi, ("rad/s", "deg/s"): 180 / math.pi, ("rad/s", "rpm"): 30 / math.pi, ("V", "mV"): 1e3,
    ("A", "mA"): 1e3, ("m", "mm"): 1e3, ("Nm", "mNm"): 1e3,
}  # fmt: skip


class Place(Struct, frozen=True):
    """Where a value of the rig stands: the signal's value is scale times the rig's, and factor times what travels plus offset.

    Args:
        key: of its message: identifier, with the flag of <linux/can.h> for an extended one.
        signal: its name.
        scale: see above.
        factor, offset: of the database.
        low, high: least and largest value of the signal.
        real: whether a floating-point number travels.
    """

    key: int
    signal: str
    scale: float
    factor: float
    offset: float
    low: float
    high: float
    real: bool

    def sent(self, value: float) -> float:
        """Return what travels for a value of the rig: of what the signal can hold the nearest."""
        number = (min(max(self.scale * value, self.low), self.high) - self.offset) / self.factor
        return number if self.real else round(number)

    def received(self, number: float) -> float:
        """Return the rig's value for what travelled; NaN for what the signal cannot be."""
        value = self.factor * number + self.offset
        slack = 0.0 if self.real else abs(self.factor) / 2  # what the decimals of the limits leave open
        return value / self.scale if self.low - slack <= value <= self.high + slack else math.nan


class MessageTable(Struct, frozen=True):
    """The signals.

    Args:
        messages: of the database, those in use, by key.
        outputs: of each node, in the order of its outputs; None for one that is not sent.
        references: in the order of the outputs.
        inputs: in their order.
        counters: that count the frames of their message.
        valid_s: how long a command stands, s; None: each answers one question.
    """

    messages: Mapping[int, Any]
    outputs: tuple[tuple[Place | None, ...], ...]
    references: tuple[Place | None, ...]
    inputs: tuple[Place, ...]
    counters: tuple[Place, ...]
    valid_s: float | None

    @property
    def fd(self) -> bool:
        """Whether a message in use is a CAN FD frame."""
        return any(message.is_fd for message in self.messages.values())

    @property
    def commands(self) -> frozenset[int]:
        """Keys of the messages that the controller sends."""
        return frozenset(place.key for place in self.inputs)

    @property
    def measured(self) -> frozenset[int]:
        """Keys of the messages with measured outputs."""
        return frozenset(place.key for places in self.outputs for place in places if place is not None)

    def filters(self) -> list[dict[str, int | bool]]:
        """Return the acceptance filters of the commands, as python-can writes them."""
        return [
            {"can_id": key & ID_MASK, "can_mask": ID_MASK if key & EXTENDED else LARGEST, "extended": bool(key & EXTENDED)}
            for key in sorted(self.commands)
        ]


def names_of(options: Mapping[str, str]) -> list[list[str]]:
    """Return what the options say: the outputs of each node, then references, inputs and counters. No database is read.

    >>> names_of({"outputs": "E.Angle,;G.Rate:rad/s", "inputs": "D.U"})
    [['E.Angle', ''], ['G.Rate:rad/s'], [], ['D.U'], []]
    """
    apart = [*options.get("outputs", "").split(";"), *(options.get(name, "") for name in ("references", "inputs", "counters"))]
    return [text.split(",") if text else [] for text in apart]


def read_table(options: Mapping[str, str]) -> MessageTable:
    """Return the signals that the options of a URI name.

    Args:
        options: of the URI, ``dbc`` among them.

    Raises:
        ValueError: a file that is no DBC, a name that it does not have, or a signal that cannot be used so.
    """
    path = options["dbc"]
    try:
        text = read_bounded(path, "a DBC", _LARGEST_DBC).decode("cp1252", "replace")
    except TransportError as error:
        raise FieldError("dbc", f"{error}") from error
    try:
        messages = read_dbc(text).messages
    except ValueError as error:
        raise FieldError("dbc", f"{path}: {error}") from error
    return _table(messages, options)


def _table(messages: Sequence[Any], said: Mapping[str, str]) -> MessageTable:
    by_name = {message.name: message for message in messages}
    used: dict[int, Any] = {}
    taken: dict[tuple[int, str], str] = {}  # signals, and by which option

    def place(option: str, text: str) -> Place | None:
        """Return where MESSAGE.SIGNAL[*SCALE][:UNIT] stands, None for an empty text."""
        if not text:
            return None
        named, _, unit = text.partition(":")
        named, times, scale = named.partition("*")
        name, _, signal_name = named.partition(".")
        message = _found(option, "message", name, by_name)
        signal = _found(option, f"signal of {name}", signal_name, {signal.name: signal for signal in message.signals})
        if message.is_multiplexed() or message.is_container:
            raise FieldError(option, f"message {name} is multiplexed, expected one whose signals all have a place of their own")
        try:
            check_places(message)
        except ValueError as error:
            raise FieldError(option, str(error)) from error
        key = message.frame_id | EXTENDED * bool(message.is_extended_frame)
        others = {other for (at, _), other in taken.items() if at == key}
        if (key, signal_name) in taken or (others and ("inputs" in others) != (option == "inputs")):
            raise FieldError(option, f"{named}: is, or its message is, among the {min(others)} already")
        used[key], taken[key, signal_name] = message, option
        factor = _scale(option, named, scale) if times else _same_unit(option, named, unit, signal.unit)
        return _place(option, key, signal, factor)

    apart = names_of(said)
    options = [*["outputs"] * (len(apart) - 3), "references", "inputs", "counters"]
    *outputs, references, inputs, counters = (
        tuple(place(option, text) for text in texts) for option, texts in zip(options, apart, strict=True)
    )
    found = MessageTable(
        messages=used, outputs=tuple(outputs), references=references, inputs=tuple(filter(None, inputs)),
        counters=tuple(filter(None, counters)), valid_s=_valid(said.get("valid", "")),
    )  # fmt: skip
    if not found.measured or not inputs or len(found.inputs) < len(inputs):
        raise FieldError("outputs, inputs", "expected MESSAGE.SIGNAL of one output at least, and of every input")
    return found


def _found(option: str, what: str, name: str, known: Mapping[str, Any]) -> Any:
    if name in known:
        return known[name]
    near = nearest(name, known)
    some = ", ".join([*known][:8]) + (", ..." if len(known) > 8 else "")
    hint = f"did you mean {near!r}?" if near else f"expected one of {some}" if known else "there is none"
    raise FieldError(option, f"no {what} is called {name!r:.60}, {hint}")


def _valid(text: str) -> float | None:
    if not text:
        return None
    with suppress(ValueError):
        if 0 < float(text) <= _LONGEST_VALID_S:
            return float(text)
    raise FieldError("valid", f"{text!r:.20}, expected seconds up to {_LONGEST_VALID_S:g}")


def _scale(option: str, named: str, text: str) -> float:
    with suppress(ValueError):
        if 0 < abs(float(text)) < math.inf:
            return float(text)
    raise FieldError(option, f"{named}*{text:.20}: expected a factor, as in {named}*57.3")


def _same_unit(option: str, named: str, unit: str, of_signal: str | None) -> float:
    """Return 1; two units that are not the same are refused, with the factor between them where it is known."""
    ours, theirs = (text.replace(" ", "").replace("*", "").replace("\u00b0", "deg") for text in (unit, of_signal or ""))
    if not ours or not theirs or ours.lower() == theirs.lower():
        return 1.0
    factor = _PER_UNIT.get((ours, theirs))
    if factor is None and (theirs, ours) in _PER_UNIT:
        factor = 1 / _PER_UNIT[theirs, ours]
    example = f"{named}*{'FACTOR' if factor is None else repr(factor)}"
    raise FieldError(option, f"{named} is in {of_signal!r}, the rig's value in {unit!r}; say the factor: {example}")


def _place(option: str, key: int, signal: Any, scale: float) -> Place:
    factor, offset, real, signed = float(signal.scale), float(signal.offset), bool(signal.is_float), bool(signal.is_signed)
    if not (math.isfinite(factor) and factor and math.isfinite(offset)):
        raise FieldError(option, f"signal {signal.name}: factor {factor:g}, offset {offset:g}, expected finite ones, no factor 0")
    top = _REAL[signal.length] if real else 2.0 ** (signal.length - signed) - 1
    bottom = -top if real else -top - 1 if signed else 0.0
    low, high = (bottom, top) if real else sorted(factor * number + offset for number in (bottom, top))
    low = low if signal.minimum is None else max(low, float(signal.minimum))
    high = high if signal.maximum is None else min(high, float(signal.maximum))
    if not low < high:
        raise FieldError(option, f"signal {signal.name}: its limits {low:g} and {high:g} leave it one value, or none")
    return Place(key, signal.name, scale, factor, offset, low, high, real)
