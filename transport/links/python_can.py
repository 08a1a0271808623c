"""python-can as our links use it: without asammdf, and any of its buses frame by frame; the `hil` bus needs none of it.

asammdf is imported where it is installed, and with it pandas and cryptography. Only who reads or writes ``.mf4`` needs it
(`with_mf4`). Its import takes longer than all others of a process of a loop together, and swallows a Ctrl-C that comes meanwhile.
What python-can notes of single frames is not printed: a file of a million odd lines would print a million.
"""

from __future__ import annotations

import importlib
import logging
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from inspect import Parameter, signature
from typing import TYPE_CHECKING, Any, Final

from transport.links import TransportError, split_uri
from transport.links.can_datagram import ERROR, EXTENDED, ID_MASK, REMOTE
from transport.links.can_open import check_options, remedy, value_of

if TYPE_CHECKING:
    from transport.can_bus_model.disturbances import BusFault

if "can" in sys.modules or "asammdf" in sys.modules:
    import can
else:
    sys.modules["asammdf"] = None  # type: ignore[assignment]
    try:
        import can
    finally:
        del sys.modules["asammdf"]

logging.getLogger("can").addHandler(logging.NullHandler())  # else Python prints warnings; a program that asks for them has them

__all__ = ["INTERFACES", "MessageFrames", "bus_of", "can", "join_interface", "options_of", "with_mf4"]

INTERFACES: Final = can.VALID_INTERFACES
"""Names of the interfaces that python-can knows."""


def with_mf4() -> type[can.io.mf4.MF4Writer]:
    """Return python-can's writer of ``.mf4``, with asammdf imported.

    Raises:
        ImportError: asammdf is not installed.
    """
    import asammdf  # noqa: F401

    writer: type[can.io.mf4.MF4Writer] = importlib.reload(can.io.mf4).MF4Writer
    return writer


_NO_FRAME: Final = (REMOTE, False, b"")


class MessageFrames:
    """Frames by way of the messages of a bus.

    Args:
        bus: of python-can; it is shut down with the link.
        fd: CAN FD frames, with bit rate switch.
    """

    def __init__(self, bus: can.BusABC, fd: bool) -> None:
        self._bus, self._fd = bus, fd
        self.lost = self.turned_away = self.filtered = 0  # no such bus says so

    def send_frame(self, identifier: int, data: bytes) -> bool:
        """Send a frame with a standard identifier; return whether a participant took it: as far as known."""
        return self.send_as(identifier, self._fd, data)

    def send_as(self, identifier: int, fd: bool, data: bytes) -> bool:
        """Send a frame of either format, the flag of <linux/can.h> in its identifier says an extended one; return as before."""
        number, extended = identifier & ID_MASK, bool(identifier & EXTENDED)
        message = can.Message(arbitration_id=number, is_extended_id=extended, is_fd=fd, bitrate_switch=fd, data=data)
        try:
            self._bus.send(message, 0.0)
        except can.CanError as error:
            raise _of_system(error) from error
        return True

    def recv_frame(self, timeout: float) -> tuple[int, bool, bytes] | None:
        """Receive: identifier with the flags of <linux/can.h>, whether FD, data; or None.

        A datagram of ``udp_multicast`` may come from anyone: what is no frame is a remote one, which a link calls malformed.
        """
        try:
            message = self._bus.recv(timeout)
            if message is None:
                return None
            flags = ERROR * bool(message.is_error_frame) | REMOTE * bool(message.is_remote_frame)
            flags |= EXTENDED * bool(message.is_extended_id)
            return message.arbitration_id | flags, bool(message.is_fd), bytes(message.data)
        except can.CanError as error:
            if error.error_code is None and not isinstance(error.__cause__, OSError | None):
                return _NO_FRAME
            raise _of_system(error) from error
        except TypeError:
            return _NO_FRAME

    def plan(self, faults: Sequence[BusFault], seed: int, senders: Sequence[Sequence[int]]) -> None:
        """Refuse to disturb bits.

        Raises:
            TransportError: always.
        """
        raise TransportError("no bus of ours, whose bits could be disturbed")

    def shutdown(self) -> None:
        """Leave the bus."""
        try:
            self._bus.shutdown()
        except can.CanError as error:
            raise _of_system(error) from error


def _of_system(error: can.CanError) -> OSError:
    return OSError(error.error_code, str(error))


def bus_of(uri: str, *, fd: bool) -> can.BusABC:
    """Return a bus of python-can, whatever travels on it.

    Args:
        uri: ``can:INTERFACE:CHANNEL``, with options of the interface.
        fd: whether it takes CAN FD frames, where the URI does not say.

    Raises:
        TransportError: another link, or it cannot be had.
    """
    scheme, address, options = split_uri(uri)
    if scheme != "can":
        raise TransportError(f"link {uri!r}: expected can:INTERFACE:CHANNEL, such as can:socketcan:vcan0")
    check_options(uri)
    interface, _, channel = address.partition(":")
    said: dict[str, Any] = {name: value_of(text) for name, text in options.items()}
    try:
        return can.Bus(channel, interface=interface, ignore_config=True, **{"fd": fd, **said})
    except (can.CanError, OSError, ValueError, TypeError) as error:
        raise TransportError(f"link {uri!r}: {error}{remedy(interface, channel, error)}") from error


def join_interface(interface: str, channel: str, *, fd: bool, quiet: bool, options: dict[str, Any]) -> MessageFrames:
    """Join a bus over an interface of python-can.

    Args:
        interface: its name.
        channel: of the interface.
        fd: CAN FD frames.
        quiet: whether what it warns of is left unsaid.
        options: whatever the interface takes.

    Raises:
        Exception: a back end without its driver raises anything.
    """
    logging.getLogger("can").propagate = False  # what python-can has to say, we say in one line
    if interface == "virtual":
        options = {**options, "protocol": can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20}
    elif fd or interface == "udp_multicast":
        options = {**options, "fd": fd}
    with warnings.catch_warnings():
        if quiet:
            warnings.simplefilter("ignore")
        return MessageFrames(can.Bus(interface=interface, channel=channel, ignore_config=True, **options), fd)


def options_of(interface: str) -> tuple[list[str], bool]:
    """Return the names of the options of an interface, and whether it takes any other; none of one without its driver."""
    with suppress(Exception):
        module, name = can.interfaces.BACKENDS[interface]
        parameters = signature(getattr(import_module(module), name)).parameters
        return [*parameters], any(parameter.kind is Parameter.VAR_KEYWORD for parameter in parameters.values())
    return [], False
