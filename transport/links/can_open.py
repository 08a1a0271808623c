"""Open a CAN link by its URI: what may stand there, whether the interface can be had, and who is there already."""

from __future__ import annotations

import logging
import os
import warnings
from contextlib import ExitStack, suppress
from difflib import get_close_matches
from errno import EAFNOSUPPORT, ENODEV
from importlib import import_module
from inspect import Parameter, signature
from pathlib import Path
from typing import Any, Final

from transport.links.can_bus import bus_directory
from transport.links.can_identifiers import filters, identifiers_of
from transport.links.can_link import CanLink
from transport.links.link import Role, TransportError, split_uri
from transport.links.private_directory import Claim, network
from transport.links.python_can import can

OPTIONS: Final = ("fd", "pad", "base", "nodes", "ids", "control")
"""What a CAN link's URI may say of its frames; the rest is the interface's."""

_RESERVED: Final = ("args", "kwargs", "channel", "interface", "config_context", "ignore_config", "can_filters", "protocol")
_BIT_RATES: Final = ("bitrate", "data_bitrate", "sample_point", "data_sample_point")
_SWALLOWING: Final = ("hil", "socketcan", "udp_multicast", "virtual")  # take any option, and ignore it; need no driver
_NETWORK: Final = Path("/sys/class/net")
_SILENCE: Final = logging.NullHandler()


def open_can(uri: str, role: Role) -> CanLink:
    """Open one end of a link over a python-can interface.

    Args:
        uri: ``can:<interface>:<channel>``, with the options ``fd`` (1 or 0), ``pad`` (1 or 0), ``base`` (first identifier, a
            multiple of 0x100), ``nodes`` (number of sensor nodes) or ``ids`` (the identifiers of each node, as in
            ``0x141,0x150-0x151``), ``control`` (those of the control packets), and whatever the interface takes, ``bitrate`` for
            instance. ``virtual`` is python-can's bus within one process.
        role: "rig" or "controller".

    Raises:
        TransportError: a bad URI, or an interface that cannot be opened; the message names the remedy.

    >>> open_can("can:hil", "rig")
    Traceback (most recent call last):
    transport.links.link.TransportError: link 'can:hil': no channel, expected can:<interface>:<channel>, as in can:hil:rig0
    """
    _, address, options = split_uri(uri)
    interface, _, channel = address.partition(":")
    if interface not in can.VALID_INTERFACES:
        near = get_close_matches(interface, can.VALID_INTERFACES, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(sorted(can.VALID_INTERFACES))}"
        raise TransportError(f"link {uri!r}: python-can has no interface {interface!r}, {hint}")
    fd = options.pop("fd", "1")
    if fd not in ("0", "1"):
        raise TransportError(f"link {uri!r}: fd={fd}, expected 1 (CAN FD) or 0 (classic CAN)")
    pad = options.pop("pad", "0")
    if pad not in ("0", fd):
        raise TransportError(f"link {uri!r}: pad={pad}, expected 1 (FD frames of 64 bytes) or 0; classic frames have no padding")
    flexible = fd == "1"
    identifiers = identifiers_of(uri, options, flexible)
    logger = logging.getLogger("can")  # what python-can has to say, we say in one line
    logger.addHandler(_SILENCE)
    logger.propagate = False
    _check_options(uri, interface, options)
    accepted = identifiers.of("controller" if role == "rig" else "rig")
    arguments: dict[str, Any] = {name: _value(text) for name, text in options.items()}
    arguments["can_filters"] = filters(accepted)
    if interface == "virtual":
        arguments["protocol"] = can.CanProtocol.CAN_FD if flexible else can.CanProtocol.CAN_20
    elif flexible or interface in ("hil", "udp_multicast"):
        arguments["fd"] = flexible
    if interface == "udp_multicast":
        arguments.setdefault("hop_limit", 0)  # python-can's default of 1 puts every frame on the local network

    def join() -> can.BusABC:
        with warnings.catch_warnings():
            if role == "controller":  # the rig says of both that a bit rate times nothing
                warnings.simplefilter("ignore")
            return can.Bus(interface=interface, channel=channel, ignore_config=True, **arguments)

    if interface == "socketcan":
        _check_interface(uri, channel, flexible)
    with ExitStack() as held:  # until the link holds them
        at, choose = ("can", interface, str(_world(interface)), channel), "another channel or base"
        claims = [held.enter_context(Claim(uri, role, *at, own[0], choose=choose)) for own in accepted]
        try:
            link = CanLink(uri, role, join, identifiers=identifiers, fd=flexible, pad=pad == "1", claims=claims)
        except Exception as error:  # a back end without its driver raises anything, a NameError for instance
            said = " ".join(str(error).split()).rstrip(".") or type(error).__name__
            raise TransportError(f"link {uri!r}: {said}{_remedy(interface, channel, error)}") from error
        held.pop_all()
    return link


def _check_options(uri: str, interface: str, options: dict[str, str]) -> None:
    """Refuse what we set ourselves, and what the bus does not name, where it would swallow or choke on it."""
    known: list[str] = []
    with suppress(Exception):  # a back end without its driver; opening it says so
        module, name = can.interfaces.BACKENDS[interface]
        parameters = signature(getattr(import_module(module), name)).parameters
        known = [name for name in parameters if name not in _RESERVED]
        if any(parameter.kind is Parameter.VAR_KEYWORD for parameter in parameters.values()):
            known = [*known, *_BIT_RATES] if interface in _SWALLOWING else []
    for option in options:
        if option in _RESERVED or (known and option not in known):
            near = get_close_matches(option, [*OPTIONS, *known], n=1)
            expected = f"expected {', '.join(OPTIONS)} or what python-can's {interface} takes"
            hint = f"did you mean {near[0]!r}?" if near else expected
            raise TransportError(f"link {uri!r}: no option is called {option!r}, {hint}")


def _check_interface(uri: str, channel: str, flexible: bool) -> None:
    """Refuse a network interface that is down or too narrow; of one that is absent, opening it says so."""
    there = _NETWORK / channel
    with suppress(OSError, ValueError):
        if flexible and int((there / "mtu").read_text()) < 72:
            raise TransportError(
                f"link {uri!r}: {channel} carries classic frames only; ip link set {channel} mtu 72, or append ?fd=0"
            )
        if not int((there / "flags").read_text(), 16) & 1:
            raise TransportError(f"link {uri!r}: {channel} is down: ip link set {channel} up")


def _world(interface: str) -> object:
    """Return what channels of one name may lie apart in: directories of buses, processes, network namespaces."""
    if interface == "hil":
        return bus_directory()
    return os.getpid() if interface == "virtual" else network()


def _value(text: str) -> int | float | bool | str:
    if text in ("true", "false"):
        return text == "true"
    for read in (lambda: int(text, 0), lambda: float(text)):
        with suppress(ValueError):
            return read()
    return text


def _remedy(interface: str, channel: str, error: BaseException) -> str:
    code = error.errno if isinstance(error, OSError) else getattr(error, "error_code", None)
    if interface == "socketcan" and code == EAFNOSUPPORT:
        return "; this kernel has no CAN: use can:hil:rig0, or run inside `hil vcan -- COMMAND`"
    if interface == "socketcan" and code == ENODEV:
        up = f"ip link add dev {channel} type vcan && ip link set {channel} mtu 72 up"
        return f"; make it as root: {up}" if channel.startswith("vcan") else f"; is {channel} there? (ip link)"
    if interface == "udp_multicast":
        return "; needs a multicast route: ip link set lo multicast on; ip route add 224.0.0.0/4 dev lo"
    if interface in _SWALLOWING or isinstance(error, (TypeError, ValueError)):
        return ""
    return f"; is the driver of {interface} installed, and its device there?"
