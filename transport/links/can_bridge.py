"""A CAN controller between an interface of the kernel and a bus that takes time, as ``can0`` stands before a real wire.

What a program sends on the interface is queued here as in a controller's transmit buffer, and takes part in arbitration on the
bus. What got through on the bus from others, and the error frames of this controller, are written onto the interface. A vcan
itself knows neither time nor errors: it hands a frame to the other programs on it when it is sent, and not when it got through.
"""

from __future__ import annotations

import select
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

from transport.links.can_bus import HilBus
from transport.links.can_errors import CONTROLLER
from transport.links.python_can import can

_LOOK_S: Final = 0.1
_AT_ONCE: Final = 64
_TX_OVERFLOW: Final = 0x02  # CAN_ERR_CRTL_TX_OVERFLOW


@dataclass(slots=True)
class BridgeCounters:
    """What passed.

    Attributes:
        to_bus, to_interface: frames.
        errors: error frames, written onto the interface.
        overflows: frames for which the transmit buffer had no room; each is an error frame too.
        failed: frames that the interface did not take.
    """

    to_bus: int = 0
    to_interface: int = 0
    errors: int = 0
    overflows: int = 0
    failed: int = 0


def bridge(bus: HilBus, interface: can.BusABC, stopped: Callable[[], bool]) -> BridgeCounters:
    """Be the CAN controller of an interface until it is to stop.

    Args:
        bus: joined with ``timed=True``, and with ``berr_reporting=True`` where every destroyed frame is to be an error frame.
        interface: a bus of python-can's ``socketcan``.
        stopped: asked ten times a second, and behind every frame.
    """
    counted = BridgeCounters()
    ready = select.poll()
    for each in (bus, interface):
        ready.register(each.fileno(), select.POLLIN)
    while not stopped():
        ready.poll(1000 * _LOOK_S)
        for _ in range(_AT_ONCE):
            sent, came = _received(interface), _received(bus)
            if sent is not None and not sent.is_error_frame:
                _to_bus(bus, interface, sent, counted)
            if came is not None:
                counted.errors += came.is_error_frame
                _to_interface(interface, came, counted)
            if (sent is None and came is None) or stopped():
                break
    return counted


def _received(bus: can.BusABC) -> can.Message | None:
    with suppress(can.CanError, OSError):
        return bus.recv(0)
    return None


def _to_bus(bus: HilBus, interface: can.BusABC, sent: can.Message, counted: BridgeCounters) -> None:
    try:
        bus.send(sent)
        counted.to_bus += 1
    except can.CanOperationError:
        counted.overflows += 1
        full = bytes((0, _TX_OVERFLOW, 0, 0, 0, 0, 0, 0))
        _to_interface(interface, can.Message(arbitration_id=CONTROLLER, is_error_frame=True, data=full), counted)


def _to_interface(interface: can.BusABC, frame: can.Message, counted: BridgeCounters) -> None:
    frame.is_extended_id = frame.is_extended_id and not frame.is_error_frame
    try:
        interface.send(frame)
        counted.to_interface += not frame.is_error_frame
    except (can.CanError, OSError):
        counted.failed += 1
