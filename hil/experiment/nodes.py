"""Sensor nodes and the media that they share, as a file names them: `[network.nodes.NAME]`, `[network.media.NAME]`.

A medium may be a CAN bus that takes time: with its bit rates, and what else travels on it.
"""

from __future__ import annotations

import typing
from typing import Any, Final, Literal

from hil.experiment.table import PlugIn, Seconds, Table, named_twice, not_negative
from transport.can_bus_model import BASE_MOST, EXTENDED_MOST, BitRates
from transport.errors import FieldError
from transport.links.can_identifiers import LARGEST
from transport.wire import FD_LENGTHS

CAN_FIELDS: Final = ("bitrate", "dbitrate", "buffer", "control", "bit_error_rate", "traffic", "traffic_file", "recorded")
MOST_TRAFFIC: Final = 2000
_ZERO = typing.cast(Seconds, 0.0)


MOST_NAME: typing.Final = 128
"""Characters of the name of a message or of a node on a bus, as in a DBC file."""


class TrafficTable(Table, frozen=True, kw_only=True):
    """A message of another node on the bus, sent again and again.

    Args:
        name: of the message; by default its identifier.
        can_id: 11 bits, or 29 where ``extended``.
        period: from one to the next.
        offset: when the first one is due.
        jitter: each is queued later than it is due by up to so much, drawn again each time.
        length: bytes of data; random bytes, drawn again each time.
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
        for field in ("name", "node"):
            if len(values.get(field, "")) > MOST_NAME:
                yield f"{field}: {len(values[field])} characters, expected {MOST_NAME} at most"
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


LONGEST_BUFFER = 255
LONGEST_CYCLE = 1_000_000
TOLERANCE = 1e-9


class TriggerTable(Table, frozen=True, kw_only=True):
    """When a sensor node sends, on a schedule: whether it uses its turn.

    Args:
        kind: ``every-slot``; ``magnitude`` (some output is above the threshold), ``error`` (some output changed by more since
            the node was last asked), ``dead-band`` (some output differs by more from what was last sent) or ``relative`` (by more
            than this share of its own size).
        threshold: in the outputs' unit, of ``relative`` a share below 1; of no use to ``every-slot``.
    """

    kind: Literal["every-slot", "magnitude", "error", "dead-band", "relative"] = "every-slot"
    threshold: float = 0.0

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        threshold, kind = values.get("threshold", 0.0), values.get("kind", "every-slot")
        if threshold < 0:
            yield f"threshold: {threshold:g} is negative"
        if kind == "relative" and threshold >= 1:
            yield f"threshold: {threshold:g}, expected a share of the output's own size, below 1"
        if kind == "every-slot" and threshold:
            yield "threshold: a node that sends in every slot takes no threshold"
        if kind != "every-slot" and "threshold" not in values:
            yield f"threshold: missing; a trigger of kind {kind!r} needs one"


class ClockTable(Table, frozen=True, kw_only=True):
    """In which slots a sensor node has a packet to send, by its own clock.

    Args:
        every: slots from one packet to the next.
        phase: slot of the first one, from 0.
        random_phase: drawn once a run instead, any phase as likely as another.
        jitter: every packet is late by 0 to this many slots, drawn again each time; less than ``every``.
    """

    every: int = 1
    phase: int = 0
    random_phase: bool = False
    jitter: int = 0

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        every, phase, jitter = values.get("every", 1), values.get("phase", 0), values.get("jitter", 0)
        if not 1 <= every <= LONGEST_CYCLE:
            yield f"every: {every} slots, expected 1 to {LONGEST_CYCLE}"
            return
        if not 0 <= phase < every:
            yield f"phase: {phase}, expected 0 to every - 1 = {every - 1}"
        if phase and values.get("random_phase"):
            yield "phase: random_phase draws it; remove one of the two"
        if not 0 <= jitter < every:
            yield f"jitter: {jitter} slots, expected 0 to every - 1 = {every - 1}"

    @property
    def drawn(self) -> bool:
        """Whether the clock draws random numbers."""
        return self.random_phase or self.jitter > 0


def identifier_faults(values: typing.Mapping[str, Any], field: str) -> typing.Iterator[str]:
    """Yield what is wrong with a CAN identifier that has more than 11 bits; one may be left out."""
    if values.get(field) is not None and not 0 <= values[field] <= LARGEST:
        yield f"{field}: {values[field]:#x}, expected 0 to {LARGEST:#x} (11 bits)"


class Node(Table, frozen=True, kw_only=True):
    """A sensor node: what it measures, how many samples it sends at once, and when.

    Args:
        outputs: names of the plant's outputs that this node measures.
        id: number of the node in its packets, from 0; by default its position in the file.
        buffer: samples in one packet, the newest first.
        trigger: when the node sends.
        clock: in which slots it has something to send; by default in every one.
        law: the network from this node to the controller; by default that of ``network.sc``, with draws of its own.
        can_id: CAN identifier of its packets' first frame, 11 bits, the next ones for further frames; by default by its number
            below the base of the link. The lower one wins on a ``can-arbitration`` medium.
    """

    outputs: tuple[str, ...]
    id: int | None = None
    buffer: int = 1
    trigger: TriggerTable = TriggerTable()
    clock: ClockTable = ClockTable()
    law: typing.Annotated[Any, PlugIn("hil.laws")] = None
    can_id: int | None = None

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        if not 1 <= values.get("buffer", 1) <= LONGEST_BUFFER:
            yield f"buffer: {values['buffer']} samples, expected 1 to {LONGEST_BUFFER}"
        yield from identifier_faults(values, "can_id")
        if not values.get("outputs", ("",)):
            yield "outputs: empty; a sensor node measures something"
        yield from named_twice(values, "outputs")


class Medium(Table, frozen=True, kw_only=True):
    """What some sensor nodes share. A node that no medium names sends when it will.

    Args:
        kind: ``round-robin`` (one in a slot, in the order of ``nodes``, again and again), ``random`` (one in a slot, by chance),
            ``can-arbitration`` (the lowest CAN identifier wins; who loses waits, and its newer sample replaces the waiting
            one), ``can`` (a CAN bus in time: frames last as long as their bits) or ``independent`` (all in every slot).
        nodes: names of the nodes, for ``round-robin`` in the order of their turns (a node may have several).
        phase: ``round-robin``: position in the order in slot 0, from 0.
        probabilities: ``random``: probability of each node, independent in every slot; by default all are alike.
        matrix: ``random``: instead, Pr(next node | last node); slot 0 is drawn from ``probabilities``.
        frames: ``can-arbitration``: frames that the bus carries in a slot.
        loss: probability that what is sent is lost on the medium, independent in every slot, or of every frame.
        bitrate: ``can``: nominal bit rate, bit/s.
        dbitrate: ``can``: data bit rate; frames are CAN FD with bit-rate switch then.
        buffer: ``can``: ``overwritten`` (a newer packet of a node replaces the one that waits) or ``fifo``.
        control: ``can``: whether the control packets travel on this bus too.
        bit_error_rate: ``can``: probability that a bit is disturbed, for all nodes alike.
        traffic: ``can``: messages of other nodes.
        traffic_file: ``can``: more of them, from a file beside the experiment: CSV, a DBC with GenMsgCycleTime, or a recording
            (candump .log, .asc, .blf).
        recorded: ``can``: recorded frames, each with its time in ns, as in ``12000000 123#1122``; sent by one node, in order.
    """

    kind: Literal["independent", "round-robin", "random", "can-arbitration", "can"]
    nodes: tuple[str, ...]
    phase: int = 0
    probabilities: tuple[float, ...] = ()
    matrix: tuple[tuple[float, ...], ...] = ()
    frames: int = 1
    loss: float = 0.0
    bitrate: int | None = None
    dbitrate: int | None = None
    buffer: BufferName = "overwritten"
    control: bool = True
    bit_error_rate: float = 0.0
    traffic: tuple[TrafficTable, ...] = ()
    traffic_file: str = ""
    recorded: tuple[str, ...] = ()

    def in_words(self) -> str:
        """Return what its nodes share.

        >>> Medium(kind="can", nodes=("a",), bitrate=500_000, dbitrate=2_000_000).in_words()
        'CAN FD bus, 500 and 2000 kbit/s'
        >>> Medium(kind="can-arbitration", nodes=("a", "b"), loss=0.1).in_words()
        'CAN arbitration, loss 0.1'
        """
        if self.kind == "can":
            rates = " and ".join(f"{rate / 1000:g}" for rate in (self.bitrate, self.dbitrate) if rate)
            words = f"CAN{' FD' if self.dbitrate else ''} bus, {rates} kbit/s"
        else:
            words = {"round-robin": "turns in order", "random": "random turns", "can-arbitration": "CAN arbitration"}[self.kind]
        return words + (f", loss {self.loss:g}" if self.loss else "")

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        kind, nodes = values.get("kind"), values.get("nodes", ("",))
        if not nodes:
            yield "nodes: empty"
        yield from can_faults_of(values)
        if not 0.0 <= values.get("loss", 0.0) < 1.0:
            yield f"loss: {values['loss']:g}, expected a probability below 1"
        if not 1 <= values.get("frames", 1) <= LONGEST_BUFFER:
            yield f"frames: {values['frames']} in a slot, expected 1 to {LONGEST_BUFFER}"
        elif kind != "can-arbitration" and values.get("frames", 1) != 1:
            yield "frames: for a can-arbitration medium only"
        if kind == "independent" and values.get("loss"):
            yield "loss: an independent medium takes no loss; set it in the law of the node"
        if kind != "round-robin" and values.get("phase"):
            yield "phase: for a round-robin medium only"
        elif not 0 <= values.get("phase", 0) < max(len(nodes), 1):
            yield f"phase: {values['phase']}, expected 0 to {len(nodes) - 1}"
        if kind != "round-robin":
            yield from named_twice(values, "nodes")
        if kind != "random":
            for field in ("probabilities", "matrix"):
                if values.get(field):
                    yield f"{field}: for a random medium only"
            return
        rows = {"probabilities": values.get("probabilities", ())}
        matrix = values.get("matrix", ())
        if matrix and len(matrix) != len(nodes):
            yield f"matrix: {len(matrix)} rows for {len(nodes)} nodes"
        rows |= {f"matrix[{i}]": row for i, row in enumerate(matrix)}
        for field, row in rows.items():
            if (row or field != "probabilities") and len(row) != len(nodes):
                yield f"{field}: {len(row)} entries for {len(nodes)} nodes"
            elif row and (min(row) < 0 or abs(sum(row) - 1) > TOLERANCE):
                yield f"{field}: expected probabilities that sum to 1, not to {sum(row):g}"

    def shares(self) -> tuple[float, ...]:
        """Return the probability of each node in slot 0 of a random medium."""
        return self.probabilities or (1.0 / len(self.nodes),) * len(self.nodes)

    def transition(self) -> tuple[tuple[float, ...], ...]:
        """Return Pr(next node | last node) of a random medium."""
        return self.matrix or (self.shares(),) * len(self.nodes)
