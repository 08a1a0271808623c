"""One participant of a `hil` bus, frame by frame: what `transport.links.can_bus` is made of, without python-can's messages.

A link takes it as it is, and the loop waits for it: pyproject.toml names this module among those that are compiled.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from time import monotonic, monotonic_ns, time
from typing import TYPE_CHECKING, Any, Final

from transport.can_bus_model import BitRates
from transport.can_bus_model.node import State
from transport.links import LOOK_S, TransportError
from transport.links.can_datagram import BRS, BUS_ERROR, ERROR, FDF, FRAME, LOOK, OWN, changed, destroyed, frame_of
from transport.links.unix_mesh import Mesh

if TYPE_CHECKING:
    from transport.can_bus_model.disturbances import BusFault
    from transport.links.held_bus import StateChange
    from transport.links.timed_sender import TimedSender

_SKIPPED: Final = 64
"""So many frames that a filter keeps out are passed over in one call, lest a flood of them holds it for ever."""

_PACK: Final = FRAME.pack

_FRAME_BYTES: Final = 16
"""Size of `FRAME`."""

_FLAGS: Final = 15
"""Where `FRAME` has its flags."""


def _identifier(frame: bytes) -> int:
    """Return the identifier that `FRAME` has, without the other fields, which a link does not ask for."""
    return frame[10] | frame[11] << 8 | frame[12] << 16 | frame[13] << 24


class HilFrames:
    """One participant.

    Args:
        folder: where the participants of the channel meet.
        title: of the channel, in messages.
        fd: send and receive CAN FD frames.
        own: receive one's own frames.
        bus_errors: receive an error frame for every destroyed frame, where the bus takes time.
        rates: of a bus that takes time; None for one that does not.
        restart_s: from bus-off to when recovery begins, s; None: it stays off.
        stamped: have the time of every frame: that of a link's frame is when it arrived here.

    Attributes:
        filtered: frames that a filter kept out, or that are none.
        matches: pairs of identifier and mask that are received; None: all.
        mesh: what carries the frames.
        timed: the way onto a bus that takes time.

    Raises:
        TransportError: the folder, or the state of the bus, cannot be had.
    """

    def __init__(
        self, folder: Path, title: str, *, fd: bool, own: bool, bus_errors: bool, rates: BitRates | None, restart_s: float | None,
        stamped: bool,
    ) -> None:  # fmt: skip
        self._title, self._fd, self._own, self._bus_errors = title, fd, own, bus_errors
        self._closed = False
        self._heads: dict[int, bytes] = {}
        self.matches: tuple[tuple[int, int], ...] | None = None
        self.filtered = 0
        self.timed: TimedSender | None = None
        self.mesh = Mesh(folder, echo=own or rates is not None, looks=rates is None, stamped=stamped or rates is not None)
        if rates is not None:
            from transport.links.timed_sender import TimedSender  # loaded where a bus takes time

            callbacks = self._got_through, self._was_destroyed, self._state_changed, self._poke
            try:
                self.timed = TimedSender(folder, rates, *callbacks, restart_s)
            except TransportError:
                self.mesh.close()
                raise

    @property
    def lost(self) -> int:
        """Frames that we did not get from others because our queue was full."""
        return self.mesh.lost

    @property
    def turned_away(self) -> int:
        """How often a newcomer found no free file descriptor here."""
        return self.mesh.refused

    def _got_through(self, item: Any, end_ns: int, alone: bool) -> None:
        """Hand a frame to all participants, with the end of its EOF as its time."""
        identifier, length, flags, data = item
        stamp = time() - (monotonic_ns() - end_ns) / 1e9
        if alone:
            self.mesh.send(_PACK(stamp, 0, identifier, length, flags) + data)
        if self._own:
            self.mesh.echo(_PACK(stamp, 0, identifier, length, flags | OWN) + data)

    def _was_destroyed(self, item: Any, bit: int, alone: bool) -> None:
        """Put an error frame into our own queue and the others', as drivers of SocketCAN do with ``berr-reporting on``."""
        frame = frame_of(*item)
        own, theirs = destroyed(frame, bit, sender=True), destroyed(frame, bit, sender=False)
        if alone:
            self.mesh.send(_PACK(time(), 0, ERROR | theirs.kind, 8, 0) + theirs.data)
        self.mesh.echo(_PACK(time(), 0, ERROR | own.kind, 8, 0) + own.data)

    def _state_changed(self, before: State, change: StateChange) -> None:
        said = changed(before, change.state, change.tec, change.rec)
        self.mesh.echo(_PACK(time(), 0, ERROR | said.kind, 8, 0) + said.data)

    def _poke(self) -> None:
        """Have the others look at their error states."""
        self.mesh.send(_PACK(time(), 0, ERROR, 0, LOOK))

    def plan(self, faults: Sequence[BusFault], seed: int, senders: Sequence[Sequence[int]]) -> None:
        """Say what is wrong with the bus when, in place of what was said before; see `SharedBus.plan`.

        Raises:
            TransportError: the bus takes no time, or is shut down.
        """
        if self.timed is None or self._closed:
            raise TransportError(f"{self._title}: no bus that takes time; join it with timed=True")
        self.timed.plan(faults, seed, senders)

    def put(self, identifier: int, length: int, flags: int, data: bytes | bytearray, wait_s: float) -> bool:
        """Send a frame; return whether a participant took it, or there is none.

        Args:
            identifier: with the flags of <linux/can.h>.
            length: of the data, or what a remote frame says.
            flags: of `FRAME`.
            data: at most 64 bytes.
            wait_s: how long to wait for room in a full queue, s.

        Raises:
            TransportError: the bus is shut down.
        """
        if self._closed:
            raise TransportError(f"{self._title} is shut down")
        if self.timed is not None and not identifier & ERROR:
            return self.timed.send(frame_of(identifier, length, flags, data), (identifier, length, flags, bytes(data)), wait_s)
        now = time()
        reached = self.mesh.send(_PACK(now, 0, identifier, length, flags) + data, wait_s)
        if self._own:
            self.mesh.echo(_PACK(now, 0, identifier, length, flags | OWN) + data)
        return reached

    def take(self, timeout: float | None) -> bytes | None:
        """Return the next datagram that no filter keeps out: `FRAME`, then data.

        Args:
            timeout: s; None waits for ever. None may be returned earlier, when a participant joined or left.

        Raises:
            TransportError: the bus is shut down.
        """
        if self._closed:
            raise TransportError(f"{self._title} is shut down")
        end = None if timeout is None else monotonic() + (timeout if timeout > 0 else LOOK_S)
        for _ in range(_SKIPPED):
            frame = self.mesh.receive(timeout)
            if frame is None:
                return None
            if len(frame) < _FRAME_BYTES:
                self.filtered += 1
            elif self.timed is None or not self._not_for_us(self.timed, frame):
                if (self._fd or not frame[_FLAGS] & FDF) and (self.matches is None or self._wanted(_identifier(frame))):
                    return frame
                self.filtered += 1
            if end is not None and monotonic() >= end:
                return None
            timeout = 0.0
        return None

    def send_frame(self, identifier: int, data: bytes) -> bool:
        """Send without a `can.Message`, which halves the cost: standard identifier, FD with bit rate switch where `fd`.

        Args:
            identifier: of 11 bits.
            data: of a length that such a frame has.

        Returns:
            Whether a participant took it, or there is none; False if none of them had room.
        """
        if self._closed or self._own or self.timed is not None:
            return self.put(identifier, len(data), FDF | BRS if self._fd else 0, data, 0.0)
        head = self._heads.get(identifier << 7 | len(data))
        return self.mesh.send((self._head(identifier, len(data)) if head is None else head) + data)

    def send_as(self, identifier: int, fd: bool, data: bytes) -> bool:
        """Send a frame of either format; return whether a participant took it.

        Args:
            identifier: with the flag of <linux/can.h> for an extended one.
            fd: a CAN FD frame, with bit rate switch.
            data: of a length that such a frame has.
        """
        return self.put(identifier, len(data), FDF | BRS if fd else 0, data, 0.0)

    def _head(self, identifier: int, length: int) -> bytes:
        """Return the head of each frame of an identifier and a length, without a time, which costs a tenth of a round trip."""
        head = _PACK(0.0, 0, identifier, length, FDF | BRS if self._fd else 0)
        self._heads[identifier << 7 | length] = head
        return head

    def recv_frame(self, timeout: float) -> tuple[int, bool, bytes] | None:
        """Receive without a `can.Message`: identifier with the flags of <linux/can.h>, whether FD, data; or None.

        Args:
            timeout: s; None may come earlier, when a participant joined or left.
        """
        frame = self.take(timeout)
        return None if frame is None else (_identifier(frame), bool(frame[_FLAGS] & FDF), frame[_FRAME_BYTES:])

    def _not_for_us(self, timed: TimedSender, frame: bytes) -> bool:
        """Return whether this is no frame for a participant of a bus that takes time; look at its error state where asked to."""
        stamp, _, identifier, _, flags = FRAME.unpack_from(frame)
        if flags & LOOK:
            timed.look()
            return True
        if identifier & ERROR:
            return bool(identifier & BUS_ERROR) and not self._bus_errors
        return timed.was_off(monotonic_ns() - round((time() - stamp) * 1e9))

    def _wanted(self, identifier: int) -> bool:
        return bool(identifier & ERROR) or any(not (identifier ^ can_id) & mask for can_id, mask in self.matches or ())

    def shutdown(self) -> None:
        """Leave the bus; frames already sent still arrive. May be called twice."""
        if not self._closed:
            self._closed = True
            if self.timed is not None:
                self.timed.close()
            self.mesh.close()
