"""Open a CAN link by its URI: what may stand there, whether the interface can be had, and who is there already.

`join_channel` joins a channel of the `hil` bus by the options of its URI, or of ``can.Bus``: python-can is not needed.
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Callable
from contextlib import ExitStack, suppress
from errno import EAFNOSUPPORT, ENODEV
from functools import partial
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from transport.can_bus_model import BitRates
from transport.errors import FieldError, nearest
from transport.links import Role, TransportError, split_uri
from transport.links.can_datagram import matches_of
from transport.links.can_identifiers import MESSAGES, derived, filters, identifiers_of
from transport.links.can_link import CanLink, Frames
from transport.links.hil_frames import HilFrames
from transport.links.private_directory import Claim, bus_directory, namespace

if TYPE_CHECKING:
    from transport.links.message_table import MessageTable

OPTIONS: Final = ("fd", "pad", "base", "nodes", "ids", "control", *MESSAGES)
"""What a CAN link's URI may say of its frames; the rest is the interface's."""

_RESERVED: Final = ("args", "kwargs", "channel", "interface", "config_context", "ignore_config", "can_filters", "protocol")
_BIT_RATES: Final = ("bitrate", "data_bitrate", "sample_point", "data_sample_point")
_SWALLOWING: Final = ("hil", "socketcan", "udp_multicast", "virtual")  # take any option, and ignore it; need no driver
_NETWORK: Final = Path("/sys/class/net")
_MOST_RESTART_MS: Final = 1_000_000
_CHANNEL: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,31}")


def open_can(uri: str, role: Role) -> CanLink:
    """Open one end of a link over a python-can interface.

    Args:
        uri: ``can:<interface>:<channel>``, with the options ``fd`` (1 or 0), ``pad`` (1 or 0), ``base`` (first identifier, a
            multiple of 0x100), ``nodes`` (number of sensor nodes) or ``ids`` (the identifiers of each node, as in
            ``0x141,0x150-0x151``), ``control`` (those of the control packets), those of `transport.links.own_messages` in their
            place, and whatever the interface takes, ``bitrate`` for instance. ``virtual`` is python-can's bus within one process.
        role: "rig" or "controller".

    Raises:
        TransportError: a bad URI, or an interface that cannot be opened; the message names the remedy.

    >>> open_can("can:hil", "rig")
    Traceback (most recent call last):
    transport.links.TransportError: link 'can:hil': no channel, expected can:<interface>:<channel>, as in can:hil:rig0
    """
    _, address, options = split_uri(uri)
    interface, _, channel = address.partition(":")
    check_options(uri)
    messages = _own_messages(uri, role, options) if "dbc" in options else None
    fd = options.pop("fd", "1" if messages is None or messages.fd else "0")
    if fd not in ("0", "1"):
        raise TransportError(f"link {uri!r}: fd={fd}, expected 1 (CAN FD) or 0 (classic CAN)")
    pad = options.pop("pad", "0")
    if pad not in ("0", fd):
        raise TransportError(f"link {uri!r}: pad={pad}, expected 1 (FD frames of 64 bytes) or 0; classic frames have no padding")
    flexible = fd == "1"
    if messages is None:
        identifiers = identifiers_of(uri, options, flexible)
        accepted = identifiers.of("controller" if role == "rig" else "rig")
        owned, wanted = [own[0] for own in accepted], filters(accepted)
    else:
        identifiers, wanted = derived(nodes=len(messages.outputs)), messages.filters()
        owned = [frame["can_id"] for frame in wanted]
    arguments: dict[str, Any] = {name: value_of(text) for name, text in options.items()}
    if interface == "udp_multicast":
        arguments.setdefault("hop_limit", 0)  # python-can's default of 1 puts every frame on the local network
    quiet = role == "controller"  # the rig says of both that a bit rate times nothing
    join: Callable[[], Frames]
    if interface == "hil":
        wanted = [] if messages is None else wanted  # the link sorts out the rest
        join = partial(_join_hil, channel, quiet=quiet, wanted=wanted, fd=flexible, **arguments)
    else:
        from transport.links.python_can import join_interface

        arguments["can_filters"] = wanted
        join = partial(join_interface, interface, channel, fd=flexible, quiet=quiet, options=arguments)
    if interface == "socketcan":
        _check_interface(uri, channel, flexible)
    if messages is not None:
        from transport.links.own_messages import OwnMessages

        joins, own = join, messages
        join = lambda: OwnMessages(joins(), own)  # noqa: E731
    with ExitStack() as held:  # until the link holds them
        port = str(arguments.get("port", ""))  # on another port of a multicast group is another bus
        at, choose = ("can", interface, str(_world(interface)), channel, port), "another channel or base"
        claims = [held.enter_context(Claim(uri, role, *at, own, choose=choose)) for own in owned]
        try:
            packed = flexible or messages is not None
            link = CanLink(uri, role, join, identifiers=identifiers, fd=packed, pad=pad == "1", claims=claims)
        except Exception as error:  # a back end without its driver raises anything, a NameError for instance
            said = " ".join(str(error).split()).rstrip(".") or type(error).__name__
            raise TransportError(f"link {uri!r}: {said}{remedy(interface, channel, error)}") from error
        held.pop_all()
    return link


def _own_messages(uri: str, role: Role, options: dict[str, str]) -> MessageTable:
    """Return the messages that the controller has of its own, and take their options out.

    Raises:
        TransportError: the end is not the rig's, or options of the rig's own packets stand beside them.
    """
    from transport.links.message_table import read_table  # of the few links that have them; it reads a DBC

    if role != "rig":
        raise TransportError(
            f"link {uri!r}: dbc: its other end is your own controller, with its own messages; start it, and the rig by hil rig"
        )
    beside = [name for name in ("pad", "base", "nodes", "ids", "control") if name in options]
    if beside:
        raise TransportError(f"link {uri!r}: {beside[0]}: says how the rig's own packets travel; with dbc= none do")
    try:
        messages = read_table({name: options.pop(name) for name in MESSAGES if name in options})
    except ValueError as error:
        raise TransportError(f"link {uri!r}: {error}") from error
    if messages.fd and options.get("fd") == "0":
        raise TransportError(f"link {uri!r}: fd=0, and the DBC has CAN FD messages among those in use")
    return messages


def _join_hil(channel: str, *, quiet: bool, wanted: list[dict[str, int | bool]], **options: Any) -> HilFrames:
    with warnings.catch_warnings():
        if quiet:
            warnings.simplefilter("ignore")
        frames = join_channel(channel, **options)
    frames.matches = matches_of(wanted) or None
    return frames


def _check_name(uri: str, interface: str) -> None:
    """Refuse an interface that python-can does not know."""
    from transport.links.python_can import INTERFACES

    if interface not in INTERFACES:
        near = nearest(interface, INTERFACES)
        hint = f"did you mean {near!r}?" if near else f"there are {', '.join(sorted(INTERFACES))}"
        raise TransportError(f"link {uri!r}: python-can has no interface {interface!r}, {hint}")


def _names_of(interface: str) -> tuple[list[str], bool]:
    """Return the names of an interface's options, and whether it takes any other; none of a back end without its driver."""
    if interface == "hil":
        return [name for name in signature(join_channel).parameters if name not in ("name", "stamped")], False
    from transport.links.python_can import options_of

    return options_of(interface)


def check_options(uri: str) -> None:
    """Refuse an interface and options of a CAN link's URI that are none, where the bus would swallow or choke on them.

    Raises:
        TransportError: with what is closest.
    """
    _, address, said = split_uri(uri)
    interface, options = address.partition(":")[0], [name for name in said if name not in (*OPTIONS, "auth")]
    if interface != "hil":
        _check_name(uri, interface)
    if not options:
        return
    names, takes_any = _names_of(interface)
    known = [name for name in names if name not in _RESERVED]
    if takes_any:
        known = [*known, *_BIT_RATES] if interface in _SWALLOWING else []
    for option in options:
        if option in _RESERVED or (known and option not in known):
            near = nearest(option, [*OPTIONS, *known])
            expected = f"expected {', '.join(OPTIONS)} or what python-can's {interface} takes"
            hint = f"did you mean {near!r}?" if near else expected
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
    return os.getpid() if interface == "virtual" else namespace("net")


def value_of(text: str) -> int | float | bool | str:
    """Return what an option of a URI says: a number, true or false, or the text."""
    if text in ("true", "false"):
        return text == "true"
    for read in (lambda: int(text, 0), lambda: float(text)):
        with suppress(ValueError):
            return read()
    return text


def remedy(interface: str, channel: str, error: BaseException) -> str:
    """Return what helps where an interface cannot be had, after a semicolon; nothing where that is not known."""
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


def join_channel(
    name: str, *, fd: bool = True, receive_own_messages: bool = False, timed: object = False, bitrate: object = None,
    dbitrate: object = None, data_bitrate: object = None, berr_reporting: object = False, restart_ms: object = None,
    sample_point: object = None, data_sample_point: object = None, stamped: bool = False,
) -> HilFrames:  # fmt: skip
    """Join a channel.

    Args:
        name: of the channel.
        fd, receive_own_messages, timed, bitrate, dbitrate, data_bitrate, berr_reporting, restart_ms: see
            `transport.links.can_bus.HilBus`.
        sample_point, data_sample_point: taken and ignored.
        stamped: see `HilFrames`.

    Raises:
        TransportError: the name or a rate is not allowed, or the directory cannot be had.
    """
    if not _CHANNEL.fullmatch(name):
        raise TransportError(f"hil: channel {name!r}: expected up to 32 letters, digits, '_', '-', '.'")
    try:
        return HilFrames(
            bus_directory() / name, f"hil channel '{name}'", fd=fd, own=receive_own_messages, bus_errors=bool(berr_reporting),
            rates=timed_rates(timed, bitrate, dbitrate if data_bitrate is None else data_bitrate), restart_s=restart(restart_ms),
            stamped=stamped,
        )  # fmt: skip
    except (FieldError, TransportError, OSError) as error:
        raise TransportError(f"hil: channel {name!r}: {error}") from error


def rate(said: object, field: str) -> int:
    """Return a bit rate that was written as a number or as text, in bit/s.

    Raises:
        ValueError: it is none.

    >>> rate("500k", "bitrate"), rate("2M", "dbitrate"), rate(125000, "bitrate"), rate("83.333k", "bitrate")
    (500000, 2000000, 125000, 83333)
    """
    text = str(said).strip()
    scale = {"k": 1_000, "M": 1_000_000}.get(text[-1:], 1)
    with suppress(ValueError):
        number = float(text[:-1] if scale > 1 else text) * scale
        if number == round(number) and not isinstance(said, bool):
            return round(number)
    raise FieldError(field, f"{said!r:.40}, expected bit/s such as 500000, 500k or 2M")


def timed_rates(timed: object, bitrate: object, dbitrate: object) -> BitRates | None:
    """Return the rates of a bus that takes time, None for one that does not; a rate that times nothing is warned of.

    Raises:
        ValueError: a rate that no controller has, or none.
    """
    if timed in (False, 0, None):
        if bitrate is not None:
            warnings.warn("hil: bitrate times nothing on this bus; add timed=True for a bus that takes time", stacklevel=3)
        return None
    if timed is not True and timed != 1:
        raise FieldError("timed", f"{timed!r:.40}, expected True or False")
    if bitrate is None:
        raise FieldError("bitrate", "missing; a bus that takes time has one, such as 500k")
    return BitRates(rate(bitrate, "bitrate"), None if dbitrate is None else rate(dbitrate, "dbitrate"))


def restart(said: object) -> float | None:
    """Return from bus-off to when recovery begins, s; None for never.

    Raises:
        ValueError: no time.

    >>> restart(100), restart("0"), restart(None)
    (0.1, None, None)
    """
    with suppress(ValueError):
        number = float(str(said)) if said is not None and not isinstance(said, bool) else 0.0
        if 0 <= number <= _MOST_RESTART_MS:
            return number / 1000 or None
    raise FieldError("restart_ms", f"{said!r:.40}, expected milliseconds, 0 to {_MOST_RESTART_MS}; 0: it stays off the bus")
