"""A link over any python-can interface: ``can:<interface>:<channel>[?fd=0&base=0x200&...]``.

A sensor packet has the identifiers of its node, a control packet those of the controller; fragment i of 64 bytes (``fd=1``) or 8
(``fd=0``) has the i-th of them, see `transport.links.can_identifiers`. What is put together is checked by the packet's CRC, and
by the node's number in it: what says another number than its identifier is malformed. A slot without a node's packet, and the
hello, come as the first node's. `transport/hilrig.dbc` names every signal of one node for the default base
0x100, ``hil dbc EXPERIMENT`` those of each node of an experiment.
A frame is as short as its packet allows; with ``pad=1`` every FD frame has 64 bytes, for tools that insist on the DBC's length.

Each role receives the other's identifiers only. Error frames, foreign frames and faults of the bus are counted; the link works
again when the interface does.
"""

from __future__ import annotations

import select
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from errno import EBADF, ENODEV, ENXIO
from time import monotonic
from typing import TYPE_CHECKING, Final, Protocol

from msgspec.structs import replace

from transport.links import LOOK_S, BusStatus, Closing, LinkCounters, Role, TransportError
from transport.links.can_datagram import ERROR, ID_MASK, REMOTE, status
from transport.links.can_identifiers import FRAGMENTS, Identifiers, derived
from transport.links.hil_frames import HilFrames
from transport.packets import decode, frame_length, node_of, packet_size

if TYPE_CHECKING:
    from transport.can_bus_model.disturbances import BusFault
    from transport.can_bus_model.node import State

_FAULTS: Final = (TransportError, OSError, ValueError)
_GONE: Final = (ENODEV, ENXIO, EBADF)  # the socket is bound to nothing any more
_REOPEN_EVERY: Final = 10
_MOST_STATUSES: Final = 16
_FAULT_PAUSE_S: Final = 0.01
_SKIPPED: Final = 2 * FRAGMENTS
"""So many frames that complete no packet are taken in one call, lest a flood of them holds it for ever."""


class Frames(Protocol):
    """A bus as the link uses it: `transport.links.hil_frames.HilFrames`, or `transport.links.python_can.MessageFrames`.

    A call that fails raises an `OSError` with the system's number where there is one, a `ValueError` where its socket is closed.
    """

    @property
    def lost(self) -> int: ...

    @property
    def turned_away(self) -> int: ...

    @property
    def filtered(self) -> int: ...

    def send_frame(self, identifier: int, data: bytes) -> bool: ...

    def recv_frame(self, timeout: float) -> tuple[int, bool, bytes] | None: ...

    def plan(self, faults: Sequence[BusFault], seed: int, senders: Sequence[Sequence[int]]) -> None: ...

    def shutdown(self) -> None: ...


class CanLink(Closing):
    """One end of a link on a CAN bus.

    A packet counts as dropped where no listener had room for it (`can:hil` says so), and where we had none: one that never
    reads, be it a logger or a flooder, does not make it so.

    Args:
        uri: for messages.
        role: the rig sends sensor packets and receives control packets, the controller the other way round.
        join: opens the bus with the given filters; called again when the interface has vanished.
        identifiers: of each node and of the controller; by default those of one node below 0x100.
        fd: one CAN FD frame of up to 64 bytes, or classic frames of 8.
        pad: fill every FD frame up to 64 bytes.
        claims: closed with the link.
    """

    def __init__(
        self,
        uri: str,
        role: Role,
        join: Callable[[], Frames],
        *,
        identifiers: Identifiers | None = None,
        fd: bool = True,
        pad: bool = False,
        claims: Sequence[Closing] = (),
    ) -> None:
        self.uri = uri
        self._counters = LinkCounters()
        self._sent = self._received = 0
        own = identifiers or derived(fd=fd)
        self._say, others = own.of(role), own.of("controller" if role == "rig" else "rig")
        self._receives = {identifier: (node, i) for node, ids in enumerate(others) for i, identifier in enumerate(ids)}
        self._fd, self._pad, self._step = fd, fd and pad, 64 if fd else 8
        self._lengths = [64 if pad else frame_length(n) for n in range(65)] if fd else [*range(9)]  # of a frame with n bytes
        self._claims, self._join = tuple(claims), join
        self._hold(join())
        self._closed = False
        self._parts = [b""] * len(others)  # of each sender, what has come of a packet in fragments
        self._state: State = "active"
        self._statuses: deque[BusStatus] = deque(maxlen=_MOST_STATUSES)
        self._row = 0  # tries to reopen, one after the other, since the interface vanished

    def _hold(self, frames: Frames) -> None:
        """Take a bus; ours is known by its class too: a call of a compiled method takes a third of one that is looked up."""
        self._frames = frames
        self._ours = frames if isinstance(frames, HilFrames) else None

    @property
    def counters(self) -> LinkCounters:
        own, frames = self._counters, self._frames
        return replace(own, sent=self._sent, received=self._received, dropped=own.dropped + frames.lost,
                       foreign=own.foreign + frames.filtered, turned_away=frames.turned_away)  # fmt: skip

    def send(self, packet: bytes) -> None:
        step, say, size, ours, reached = self._step, self._say, len(packet), self._ours, True
        node = node_of(packet) if len(say) > 1 else 0
        if self._closed or node >= len(say) or size > len(say[node]) * step:
            self._counters.dropped += 1
            return
        try:
            if size <= step and ours is not None:
                reached = ours.send_frame(say[node][0], self._filled(packet))
            else:
                for identifier, start in zip(say[node], range(0, size, step)):
                    reached &= self._frames.send_frame(identifier, self._filled(packet[start : start + step]))
        except _FAULTS as error:
            self._counters.dropped += 1
            self._fault(error, 0.0)
        else:
            if reached:
                self._sent += 1
            else:
                self._counters.dropped += 1

    def _filled(self, data: bytes) -> bytes:
        """Return the data of a frame, up to a length that it may have."""
        length = self._lengths[len(data)]
        return data if length == len(data) else data.ljust(length, b"\0")

    def receive(self, timeout_s: float) -> bytes | None:
        wait = timeout_s if timeout_s > 0 else 0.0
        begin = monotonic()  # what is left to wait after a fragment; no link has the time of anything
        for _ in range(_SKIPPED):
            if self._closed:
                return None
            try:
                frame = self._frames.recv_frame(wait) if self._ours is None else self._ours.recv_frame(wait)
            except _FAULTS as error:
                self._fault(error, wait)
                return None
            if frame is not None:
                self._row = 0
                identifier, fd, data = frame
                packet = self._packet(identifier, fd, data)
                if packet is not None:
                    self._received += 1
                    return packet
            elif self._row:  # a socket whose interface has vanished says so once, then it is silent
                self._reopen()
                return None
            if wait <= 0 and frame is None:
                return None
            left_s = (timeout_s if timeout_s > 0 else LOOK_S) - (monotonic() - begin)
            if left_s <= 0:
                return None
            wait = left_s if timeout_s > 0 else 0.0
        return None

    def _packet(self, identifier: int, fd: bool, data: bytes) -> bytes | None:
        """Return the packet that this frame is or completes."""
        place = self._receives.get(identifier)  # none with any flag set
        if place is None:
            if identifier & ERROR:
                self._counters.errors += 1
                reached = status(identifier & ID_MASK, data)
                if reached is not None and reached.state != self._state:
                    self._state = reached.state
                    self._statuses.append(reached)
            elif identifier & REMOTE:
                self._counters.malformed += 1
            else:
                self._counters.foreign += 1  # on an interface that cannot filter
            return None
        if fd != self._fd:
            self._counters.malformed += 1
            return None
        (node, index), parts = place, self._parts
        begun, several = parts[node], len(parts) > 1
        if index == 0:
            if begun:
                self._counters.malformed += 1  # it was never completed
                parts[node] = b""
            size = packet_size(data)
            if fd and size and size <= len(data) and not (several and node_of(data) != node):
                return data[:size] if self._pad else data  # alone in its frame, or one node's of several
            if fd and not several and (not size or len(data) < self._step):
                self._counters.malformed += 1  # no packet begins so, or none can follow a frame that is not full
                return None
        elif not begun or index * self._step != len(begun):
            self._counters.malformed += 1  # one before it is missing
            parts[node] = b""
            return None
        else:
            data = begun + data
            size = packet_size(data)
        parts[node] = data if size is None or size > len(data) else b""
        if parts[node]:
            return None
        if size is None or (several and node_of(data) != node) or decode(data[:size]) is None:
            self._counters.malformed += 1
            return None
        return data[:size]

    def disturb(self, faults: Sequence[BusFault], seed: int) -> None:
        try:
            self._frames.plan(faults, seed, [[], [*self._receives]])
        except _FAULTS as error:
            raise TransportError(f"link {self.uri!r}: {error}") from error

    def statuses(self) -> list[BusStatus]:
        found = [*self._statuses]
        self._statuses.clear()
        return found

    def _fault(self, error: BaseException, wait_s: float) -> None:
        """Count a fault of the bus; pause, so that a loop that polls does not spin; reopen what has vanished."""
        self._counters.errors += 1
        self._parts = [b""] * len(self._parts)
        if isinstance(error, ValueError) or (isinstance(error, OSError) and error.errno in _GONE):
            self._reopen()
        if wait_s > 0:
            select.poll().poll(1e3 * min(wait_s, _FAULT_PAUSE_S))

    def _reopen(self) -> None:
        """Join the bus anew, if it is there again; every tenth call tries."""
        self._row += 1
        if self._row % _REOPEN_EVERY == 1:
            with suppress(Exception):  # a back end whose interface is not there raises anything
                old = self._frames
                self._hold(self._join())
                self._row = 0
                old.shutdown()

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            with suppress(*_FAULTS):
                self._frames.shutdown()
            for claim in self._claims:
                claim.close()
