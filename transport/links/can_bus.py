"""The `hil` interface of python-can: a CAN (FD) bus between processes, without root, kernel module or broker.

``can.Bus(interface="hil", channel="rig0")`` joins the bus `rig0` of this user, as do `can_logger -i hil -c rig0`,
`can_player` and `cantools monitor`. Frames travel over Unix sockets (see `transport.links.unix_mesh`) in the directory
``/tmp/hil-can-<uid>/<channel>``, or under `HIL_CAN_DIR` if that is set.

Every frame carries its sender's time stamp, the same for all who receive it, but those of a link, which is timed by the kernel of
who receives them. There is no arbitration and no bit time, unless all participants say ``timed=True``: see
`transport.links.shared_bus`. A frame is lost only for a participant that has `transport.links.unix_mesh.QUEUE_LIMIT` unread
frames waiting, and the loss is counted at both ends (`dropped`, `lost`).

`bridge` is a CAN controller between an interface of the kernel and such a bus that takes time, as ``can0`` stands before a real
wire. What a program sends on the interface is queued here as in a controller's transmit buffer, and takes part in arbitration on
the bus. What got through on the bus from others, and the error frames of this controller, are written onto the interface. A vcan
itself knows neither time nor errors: it hands a frame to the other programs on it when it is sent, and not when it got through.
"""

from __future__ import annotations

import select
from contextlib import suppress
from errno import ENODEV
from typing import TYPE_CHECKING, Any, Final, NoReturn

from transport.links import TransportError
from transport.links.can_datagram import BRS, CONTROLLER, ERROR, ESI, EXTENDED, FDF, FRAME, ID_MASK, OWN, REMOTE, matches_of
from transport.links.can_open import join_channel
from transport.links.hil_frames import HilFrames
from transport.links.private_directory import bus_directory as bus_directory
from transport.links.python_can import can

if TYPE_CHECKING:
    from can.typechecking import AutoDetectedConfig, CanFilters, Channel

_STATES: Final = {"passive": can.BusState.PASSIVE, "off": can.BusState.ERROR}


def message_of(datagram: bytes, channel: str) -> can.Message:
    """Return a datagram as a message of python-can.

    Args:
        datagram: `FRAME`, then data.
        channel: name of the bus.
    """
    time_stamp, _, identifier, length, flags = FRAME.unpack_from(datagram)
    return can.Message(
        timestamp=time_stamp,
        arbitration_id=identifier & ID_MASK,
        is_extended_id=bool(identifier & EXTENDED),
        is_remote_frame=bool(identifier & REMOTE),
        is_error_frame=bool(identifier & ERROR),
        channel=channel,
        dlc=length,
        data=bytearray(datagram[FRAME.size :]),
        is_fd=bool(flags & FDF),
        is_rx=not flags & OWN,
        bitrate_switch=bool(flags & BRS),
        error_state_indicator=bool(flags & ESI),
    )


class HilBus(can.BusABC):
    """One participant of a bus.

    Args:
        channel: name of the bus, letters, digits, ``_.-``.
        can_filters: as in `can.BusABC.set_filters`; error frames always pass.
        receive_own_messages: receive one's own frames, marked ``is_rx=False``.
        fd: send and receive CAN FD frames; without it the bus is a classic one, to which FD frames are invisible.
        timed: frames last as long as their bits, and identifiers are arbitrated (see `transport.links.shared_bus`); all
            participants of a bus say so, or none.
        bitrate: nominal bit rate in bit/s, or as in ``500k``; without ``timed`` it times nothing, which a warning says.
        dbitrate, data_bitrate: data bit rate of CAN FD, likewise.
        berr_reporting: with ``timed``, whether an error frame comes for every destroyed frame too, as the option of ``ip link``.
        restart_ms: with ``timed``, from bus-off to when recovery begins, ms, as the option of ``ip link``; None or 0: it stays
            off until it joins again.
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
        try:
            self.frames = join_channel(
                name, receive_own_messages=receive_own_messages, fd=fd, timed=timed, bitrate=bitrate, dbitrate=dbitrate,
                data_bitrate=data_bitrate, berr_reporting=berr_reporting, restart_ms=restart_ms, stamped=True,
            )  # fmt: skip
        except TransportError as error:
            raise can.CanInitializationError(str(error)) from error
        self.channel = name
        self.channel_info = f"hil channel '{name}'"
        self._can_protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
        self._fd = fd
        super().__init__(channel=channel, can_filters=can_filters, **kwargs)

    @property
    def dropped(self) -> int:
        """Frames that a participant with a full queue did not get from us."""
        return self.frames.mesh.dropped

    @property
    def lost(self) -> int:
        """Frames that we did not get from others because our queue was full."""
        return self.frames.lost

    @property
    def participants(self) -> int:
        """Number of participants known, this one included."""
        return self.frames.mesh.participants

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame to all participants of the bus.

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
            flags = FDF | msg.bitrate_switch | msg.error_state_indicator << 1
        try:
            taken = self.frames.put(identifier, length, flags, data, timeout or 0.0)
        except TransportError as error:
            raise can.CanOperationError(str(error)) from error
        if not taken and self.frames.timed is not None:
            full = "the transmit buffer is full: no other participant acknowledges, or the bus is busy"
            raise can.CanOperationError(f"{self.channel_info}: {full}")

    @property
    def state(self) -> can.BusState:
        """Error active, error passive, or (off the bus) in error; a bus without time is always active."""
        timed = self.frames.timed
        if timed is None or self._is_shutdown:
            return can.BusState.ACTIVE
        return _STATES.get(timed.look().state, can.BusState.ACTIVE)

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        raise NotImplementedError("hil: the state of a bus follows from its errors")

    def _refusal(self, msg: can.Message, length: int) -> str:
        if self._is_shutdown:
            return f"{self.channel_info} is shut down"
        if msg.is_fd and not self._fd:
            return f"{self.channel_info} was opened with fd=False and carries no CAN FD frame"
        return f"{length} bytes do not fit into a {'CAN FD' if msg.is_fd else 'classic CAN'} frame"

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        try:
            taken = self.frames.take(timeout)
        except TransportError as error:
            raise can.CanOperationError(str(error)) from error
        if taken is None:
            return None, True
        return message_of(taken, self.channel), True

    def _apply_filters(self, filters: CanFilters | None) -> None:
        self.frames.matches = None if filters is None else matches_of(filters)

    def fileno(self) -> int:
        """Return a descriptor that is readable while frames wait."""
        return self.frames.mesh.fileno()

    def shutdown(self) -> None:
        """Leave the bus; frames already sent still arrive."""
        super().shutdown()
        frames: HilFrames | None = getattr(self, "frames", None)
        if frames is not None:
            frames.shutdown()

    @staticmethod
    def _detect_available_configs() -> list[Any]:
        try:
            names = sorted(path.name for path in bus_directory().iterdir() if path.is_dir())
        except OSError:
            names = []
        found: list[AutoDetectedConfig] = [{"interface": "hil", "channel": name} for name in names]
        return found


_LOOK_S: Final = 0.1
_TX_OVERFLOW: Final = 0x02  # CAN_ERR_CRTL_TX_OVERFLOW


def bridge(bus: HilBus, interface: can.BusABC) -> NoReturn:
    """Be the CAN controller of an interface, until an exception such as Ctrl-C's ends it.

    A frame that finds no room in the transmit buffer is answered with an error frame; what the interface does not take is lost.

    Args:
        bus: joined with ``timed=True``, and with ``berr_reporting=True`` where every destroyed frame is to be an error frame.
        interface: a bus of python-can's ``socketcan``; one that is down works again when it is up.

    Raises:
        can.CanError: the interface is gone for good.
    """
    ready = select.poll()
    for each in (bus, interface):
        ready.register(each.fileno(), select.POLLIN)
    while True:
        sent, came = _received(interface), _received(bus)
        if sent is not None and not sent.is_error_frame:
            try:
                bus.send(sent)
            except can.CanOperationError:
                full = bytes((0, _TX_OVERFLOW, 0, 0, 0, 0, 0, 0))
                _to_interface(interface, can.Message(arbitration_id=CONTROLLER, is_error_frame=True, data=full))
        if came is not None:
            _to_interface(interface, came)
        if sent is None and came is None:
            ready.poll(1000 * _LOOK_S)


def _received(bus: can.BusABC) -> can.Message | None:
    try:
        return bus.recv(0)
    except OSError:
        pass
    except can.CanError as error:
        if error.error_code == ENODEV:
            raise
    return None


def _to_interface(interface: can.BusABC, frame: can.Message) -> None:
    frame.is_extended_id = frame.is_extended_id and not frame.is_error_frame
    with suppress(can.CanError, OSError):
        interface.send(frame)
