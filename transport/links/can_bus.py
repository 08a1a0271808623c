"""The `hil` interface of python-can: a CAN (FD) bus between processes, without root, kernel module or broker.

``can.Bus(interface="hil", channel="rig0")`` joins the bus `rig0` of this user, as do `can_logger -i hil -c rig0`,
`can_player` and `cantools monitor`. Frames travel over Unix sockets (see `transport.links.unix_mesh`) in the directory
``/tmp/hil-can-<uid>/<channel>``, or under `HIL_CAN_DIR` if that is set.

Every frame carries the sender's time stamp, the same for all who hear it. There is no arbitration and no bit time, unless all
participants say ``timed=True``: see `transport.links.shared_bus`. A frame is lost only for a participant that has
`transport.links.unix_mesh.QUEUE_LIMIT` unread frames waiting, and the loss is counted at both ends (`dropped`, `lost`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from time import monotonic, monotonic_ns, time
from typing import TYPE_CHECKING, Any, Final

from transport.can_bus_model.node import State
from transport.can_bus_model.planned_faults import BusFault
from transport.errors import FieldError
from transport.links.can_datagram import (
    BITRATE_SWITCH,
    ERROR,
    EXTENDED,
    FD_FRAME,
    FRAME,
    ID_MASK,
    LOOK,
    OWN,
    REMOTE,
    frame_of,
    message_of,
)
from transport.links.can_errors import BUS_ERROR, changed, destroyed
from transport.links.held_bus import StateChange
from transport.links.link import LOOK_S, TransportError
from transport.links.mesh_peer import bus_directory as bus_directory
from transport.links.python_can import can
from transport.links.timed_sender import TimedSender, restart, timed_rates
from transport.links.unix_mesh import Mesh

if TYPE_CHECKING:
    from can.typechecking import AutoDetectedConfig, CanFilters, Channel

_SKIPPED: Final = 64
"""So many frames that a filter keeps out are passed over in one call, lest a flood of them holds it for ever."""

_STATES: Final = {"passive": can.BusState.PASSIVE, "off": can.BusState.ERROR}

_CHANNEL = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,31}")


class HilBus(can.BusABC):
    """One participant of a bus.

    Args:
        channel: name of the bus, letters, digits, ``_.-``.
        can_filters: as in `can.BusABC.set_filters`; error frames always pass.
        receive_own_messages: hear one's own frames, marked ``is_rx=False``.
        fd: send and hear CAN FD frames; without it the bus is a classic one, to which FD frames are invisible.
        timed: frames last as long as their bits, and identifiers are arbitrated (see `transport.links.shared_bus`); all
            participants of a bus say so, or none.
        bitrate: nominal bit rate in bit/s, or as in ``500k``; without ``timed`` it times nothing, which a warning says.
        dbitrate, data_bitrate: data bit rate of CAN FD, likewise.
        berr_reporting: with ``timed``, whether an error frame comes for every destroyed frame too, as the option of ``ip link``.
        restart_ms: with ``timed``, from bus-off to when recovery begins, ms, as the option of ``ip link``; None or 0: it stays
            off until it joins anew.
        kwargs: other timings are taken and ignored.

    Raises:
        can.CanInitializationError: the name or a rate is not allowed, or the directory cannot be had.
    """

    def __init__(
        self,
        channel: Channel = "rig0",
        can_filters: CanFilters | None = None,
        receive_own_messages: bool = False,
        fd: bool = True,
        timed: bool = False,
        bitrate: object = None,
        dbitrate: object = None,
        data_bitrate: object = None,
        berr_reporting: bool = False,
        restart_ms: object = None,
        **kwargs: object,
    ) -> None:
        name = str(channel)
        if not _CHANNEL.fullmatch(name):
            raise can.CanInitializationError(f"hil: channel {name!r}: expected up to 32 letters, digits, '_', '-', '.'")
        try:
            rates = timed_rates(timed, bitrate, dbitrate if data_bitrate is None else data_bitrate)
            restart_s = restart(restart_ms)
        except FieldError as error:
            raise can.CanInitializationError(f"hil: channel {name!r}: {error}") from error
        try:
            self._mesh = Mesh(bus_directory() / name, echo=receive_own_messages or rates is not None, looks=rates is None)
        except (TransportError, OSError) as error:
            raise can.CanInitializationError(f"hil: channel {name!r}: {error}") from error
        self.channel = name
        self.channel_info = f"hil channel '{name}'"
        self._can_protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
        self._fd = fd
        self._own, self._bus_errors = receive_own_messages, bool(berr_reporting)
        self._matches: tuple[tuple[int, int], ...] | None = None
        self.filtered = 0
        self._timed: TimedSender | None = None
        if rates is not None:
            try:
                callbacks = self._got_through, self._was_destroyed, self._state_changed, self._poke
                self._timed = TimedSender(bus_directory() / name, rates, *callbacks, restart_s)
            except TransportError as error:
                self._mesh.close()
                raise can.CanInitializationError(f"hil: channel {name!r}: {error}") from error
        super().__init__(channel=channel, can_filters=can_filters, **kwargs)

    @property
    def dropped(self) -> int:
        """Frames that a participant with a full queue did not get from us."""
        return self._mesh.dropped

    @property
    def lost(self) -> int:
        """Frames that we did not get from others because our queue was full."""
        return self._mesh.lost

    @property
    def turned_away(self) -> int:
        """How often a newcomer found no free file descriptor here."""
        return self._mesh.refused

    @property
    def participants(self) -> int:
        """Number of participants known, this one included."""
        return self._mesh.participants

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame to everybody on the bus.

        Args:
            msg: the frame.
            timeout: how long to wait for room in each full queue, s; None does not wait. A frame that found none is
                dropped there and counted.

        Raises:
            can.CanOperationError: the bus is shut down, or the frame is none this bus can carry.
        """
        data = msg.data
        length = msg.dlc if msg.is_remote_frame else len(data)
        if self._is_shutdown or length > (64 if msg.is_fd else 8) or (msg.is_fd and not self._fd):
            raise can.CanOperationError(self._refusal(msg, length))
        identifier = msg.arbitration_id & ID_MASK
        if msg.is_extended_id:
            identifier |= EXTENDED
        if msg.is_remote_frame:
            identifier |= REMOTE
        elif msg.is_error_frame:
            identifier |= ERROR
        flags = 0
        if msg.is_fd:
            flags = FD_FRAME | msg.bitrate_switch | msg.error_state_indicator << 1
        if not self._put(identifier, length, flags, data, timeout or 0.0) and self._timed is not None:
            told = "the transmit buffer is full: no other participant acknowledges, or the bus is busy"
            raise can.CanOperationError(f"{self.channel_info}: {told}")

    def _got_through(self, item: Any, end_ns: int, alone: bool) -> None:
        """Hand a frame to everybody, with the end of its EOF as its time."""
        identifier, length, flags, data = item
        stamp = time() - (monotonic_ns() - end_ns) / 1e9
        if alone:
            self._mesh.send(FRAME.pack(stamp, 0, identifier, length, flags) + data)
        if self._own:
            self._mesh.echo(FRAME.pack(stamp, 0, identifier, length, flags | OWN) + data)

    def _was_destroyed(self, item: Any, bit: int, alone: bool) -> None:
        """Put an error frame into our own queue and the others', as drivers of SocketCAN do with ``berr-reporting on``."""
        frame = frame_of(*item)
        own, theirs = (destroyed(frame, bit, sender=sender) for sender in (True, False))
        if alone:
            self._mesh.send(FRAME.pack(time(), 0, ERROR | theirs.kind, 8, 0) + theirs.data)
        self._mesh.echo(FRAME.pack(time(), 0, ERROR | own.kind, 8, 0) + own.data)

    def _state_changed(self, before: State, change: StateChange) -> None:
        said = changed(before, change.state, change.tec, change.rec)
        self._mesh.echo(FRAME.pack(time(), 0, ERROR | said.kind, 8, 0) + said.data)

    def _poke(self) -> None:
        """Have the others look at their error states."""
        self._mesh.send(FRAME.pack(time(), 0, ERROR, 0, LOOK))

    def plan(self, faults: Sequence[BusFault], seed: int, senders: Sequence[Sequence[int]]) -> None:
        """Say what is wrong with the bus when, in place of what was said before; see `SharedBus.plan`.

        Raises:
            can.CanOperationError: the bus takes no time, or is shut down.
        """
        if self._timed is None or self._is_shutdown:
            raise can.CanOperationError(f"{self.channel_info}: no bus that takes time; join it with timed=True")
        self._timed.plan(faults, seed, senders)

    @property
    def state(self) -> can.BusState:
        """Error active, error passive, or (off the bus) in error; a bus without time is always active."""
        if self._timed is None or self._is_shutdown:
            return can.BusState.ACTIVE
        return _STATES.get(self._timed.look().state, can.BusState.ACTIVE)

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        raise NotImplementedError("hil: the state of a bus follows from its errors")

    def _put(self, identifier: int, length: int, flags: int, data: bytes | bytearray, wait_s: float) -> bool:
        now = time()
        if self._timed is not None and not identifier & ERROR:
            return self._timed.send(frame_of(identifier, length, flags, data), (identifier, length, flags, bytes(data)), wait_s)
        heard = self._mesh.send(FRAME.pack(now, 0, identifier, length, flags) + data, wait_s)
        if self._own:
            self._mesh.echo(FRAME.pack(now, 0, identifier, length, flags | OWN) + data)
        return heard

    def send_frame(self, identifier: int, data: bytes) -> bool:
        """Send without a `can.Message`, which halves the cost: standard identifier, FD with bit rate switch where `fd`.

        Args:
            identifier: of 11 bits.
            data: of a length that such a frame has.

        Returns:
            Whether a participant took it, or there is none; False if none of them had room.
        """
        if self._is_shutdown:
            raise can.CanOperationError(f"{self.channel_info} is shut down")
        return self._put(identifier, len(data), FD_FRAME | BITRATE_SWITCH if self._fd else 0, data, 0.0)

    def recv_frame(self, timeout: float) -> tuple[int, bool, bytes] | None:
        """Receive without a `can.Message`: identifier with the flags of <linux/can.h>, whether FD, data; or None.

        Args:
            timeout: s; None may come earlier, when a participant joined or left.
        """
        taken = self._take(timeout)
        return None if taken is None else (taken[0][2], bool(taken[0][4] & FD_FRAME), taken[1])

    def _refusal(self, msg: can.Message, length: int) -> str:
        if self._is_shutdown:
            return f"{self.channel_info} is shut down"
        if msg.is_fd and not self._fd:
            return f"{self.channel_info} was opened with fd=False and carries no CAN FD frame"
        return f"{length} bytes do not fit into a {'CAN FD' if msg.is_fd else 'classic CAN'} frame"

    def _take(self, timeout: float | None) -> tuple[tuple[Any, ...], bytes] | None:
        """Return the fields of `FRAME` and the data of the next frame that no filter keeps out."""
        if self._is_shutdown:
            raise can.CanOperationError(f"{self.channel_info} is shut down")
        end = None if timeout is None else monotonic() + (timeout if timeout > 0 else LOOK_S)
        for _ in range(_SKIPPED):
            frame = self._mesh.receive(timeout)
            if frame is None:
                return None
            if len(frame) >= FRAME.size:
                fields = FRAME.unpack_from(frame)
                if self._timed is None or not self._not_for_us(fields):
                    if (self._fd or not fields[4] & FD_FRAME) and (self._matches is None or self._wanted(fields[2])):
                        return fields, frame[FRAME.size :]
                    self.filtered += 1
            else:
                self.filtered += 1
            if end is not None and monotonic() >= end:
                return None
            timeout = 0
        return None

    def _not_for_us(self, fields: tuple[Any, ...]) -> bool:
        """Return whether this is no frame for a participant of a bus that takes time; look at its error state where told to."""
        timed, (stamp, _, identifier, _, flags) = self._timed, fields
        if timed is None:
            return False
        if flags & LOOK:
            timed.look()
            return True
        if identifier & ERROR:
            return bool(identifier & BUS_ERROR) and not self._bus_errors
        return timed.was_off(monotonic_ns() - round((time() - stamp) * 1e9))

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        taken = self._take(timeout)
        if taken is None:
            return None, True
        return message_of(*taken, self.channel), True

    def _wanted(self, identifier: int) -> bool:
        for can_id, mask in self._matches or ():
            if not (identifier ^ can_id) & mask:
                return True
        return bool(identifier & ERROR)

    def _apply_filters(self, filters: CanFilters | None) -> None:
        if filters is None:
            self._matches = None
            return
        matches = []
        for rule in filters:
            can_id, mask = rule["can_id"] & ID_MASK, rule["can_mask"] & ID_MASK
            if "extended" in rule:
                can_id |= EXTENDED if rule["extended"] else 0
                mask |= EXTENDED
            matches.append((can_id, mask))
        self._matches = tuple(matches)

    def fileno(self) -> int:
        """Return a descriptor that is readable while frames wait."""
        return self._mesh.fileno()

    def shutdown(self) -> None:
        """Leave the bus; frames already sent still arrive."""
        super().shutdown()
        timed: TimedSender | None = getattr(self, "_timed", None)
        if timed is not None:
            timed.close()
        mesh: Mesh | None = getattr(self, "_mesh", None)
        if mesh is not None:
            mesh.close()

    @staticmethod
    def _detect_available_configs() -> list[Any]:
        try:
            names = sorted(path.name for path in bus_directory().iterdir() if path.is_dir())
        except OSError:
            names = []
        found: list[AutoDetectedConfig] = [{"interface": "hil", "channel": name} for name in names]
        return found
