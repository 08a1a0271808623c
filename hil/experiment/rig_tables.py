"""What an experiment's file says of its rig beside nodes and networks: `limits`, `[[fault]]` and `[links.keys]`.

Each key or certificate of a link stands for an option of the link's URI.
"""

from __future__ import annotations

import typing
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

import msgspec

from hil.experiment.table import LONGEST_S, Seconds, Table, not_negative
from transport.links.traits import traits_of, with_options


class Passivity(Table, frozen=True, kw_only=True):
    """A passivity controller at the rig: it observes the energy that the motor gives, at the device, without the network.

    Counted is what the motor gives beyond what the damping of device and hand takes, as their model says; it needs a plant that
    takes one force and measures the position that it acts on.

    Args:
        damping_n_s_per_m: largest damping that it injects while too much was given, in the plant's unit; 0 for none. A damper
            that is held over a sample period T is no damper beyond about 2 m/T.
        energy_j: what may be given before it damps, in J; the rounding of packets feigns less than a microjoule.
        trip_j: what trips the safe state when given, in J; never by default.
    """

    damping_n_s_per_m: float = 0.0
    energy_j: float = 1e-6
    trip_j: float | None = None

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        damping, trip = values.get("damping_n_s_per_m", 0.0), values.get("trip_j")
        if damping < 0:
            yield f"damping_n_s_per_m: {damping:g} is negative"
        elif damping == 0 and trip is None:
            yield "damping_n_s_per_m: the passivity controller neither damps nor trips; give a damping, or trip_j"
        if values.get("energy_j", 0.0) < 0:
            yield f"energy_j: {values['energy_j']:g} is negative"
        if trip is not None and trip <= 0:
            yield f"trip_j: {trip:g} is not positive"


class Limits(Table, frozen=True, kw_only=True):
    """What the rig allows, whatever the controller does; a violation latches the safe state (zero input).

    Args:
        watchdog_slots: so many slots in a row without a usable command trip the watchdog.
        input: largest absolute command per input, in the input's unit.
        state: largest absolute value of named states, in the state's unit.
        after_trip: how long the rig goes on in the safe state before the run ends.
        passivity: damping, or a trip, on the energy that the motor gives; off without the table.
    """

    watchdog_slots: int = 3
    input: tuple[float, ...] | None = None
    state: dict[str, float] = msgspec.field(default_factory=dict)
    after_trip: Seconds = typing.cast(Seconds, 1.0)  # a plain float, for the JSON Schema
    passivity: Passivity | None = None

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        if values.get("watchdog_slots", 1) < 1:
            yield f"watchdog_slots: {values['watchdog_slots']} is below 1"
        for i, bound in enumerate(values.get("input") or ()):
            if bound <= 0:
                yield f"input[{i}]: {bound:g} is not positive"
        for name, bound in values.get("state", {}).items():
            if bound <= 0:
                yield f"state.{name}: {bound:g} is not positive"
        yield from not_negative(values, "after_trip")


RESTART: typing.Final = "controller-restart"
BIT_ERRORS: typing.Final = "bit-errors"


class Fault(Table, frozen=True, kw_only=True, rename={"lasts": "for"}):
    """Something that breaks at an instant, and is whole again after a while.

    Args:
        at: when it begins.
        lasts: how long it lasts; of a restart, how long nothing answers at least.
        kind: ``cut`` (nothing arrives over the link), ``corrupt`` (one bit of every frame that arrives is flipped, drawn from the
            seed: the receiver's CRC refuses it), ``freeze`` (what is sent has the values of the last packet before, under a fresh
            time stamp), ``bus-off`` (the sender is off the bus: it sends nothing, nothing on its way arrives, and a
            controller receives nothing either; on a CAN bus with time its error counter is 256 and it acknowledges nothing, until
            it has seen 128 times 11 recessive bits behind the end), ``bit-errors`` (bits on a CAN bus with time are disturbed) or
            ``controller-restart`` (the controller forgets everything; it is silent meanwhile).
        link: ``sc`` (from all sensor nodes to the controller) or ``ca`` (from the controller to the actuator).
        node: instead, one sensor node by its name; of ``bus-off`` any node on the CAN bus.
        rate: ``bit-errors``: probability that a bit is disturbed, beside the bus's own.
        can_id: ``bit-errors``: instead, of each frame with this identifier the bit in its middle.
    """

    at: Seconds
    lasts: Seconds = typing.cast(Seconds, 0.0)
    kind: Literal["cut", "corrupt", "freeze", "bus-off", "bit-errors", "controller-restart"]
    link: Literal["sc", "ca"] | None = None
    node: str | None = None
    rate: float | None = None
    can_id: int | None = None

    @property
    def where(self) -> str:
        """What is broken, for messages."""
        if self.kind == BIT_ERRORS:
            return "the CAN bus" if self.can_id is None else f"the frames {self.can_id:#x} of the CAN bus"
        return "the controller" if self.kind == RESTART else f"node {self.node!r}" if self.node else f"network.{self.link}"

    @property
    def text(self) -> str:
        """What it is, in words.

        >>> Fault(at=Seconds(3), lasts=Seconds(0.5), kind="cut", link="ca").text
        'cut of network.ca for 0.5 s'
        """
        words = {"corrupt": "flipped bits on", "freeze": "frozen values on", "bus-off": "bus-off of", BIT_ERRORS: "bit errors on",
                 RESTART: "restart of"}  # fmt: skip
        return f"{words.get(self.kind, f'{self.kind} of')} {self.where} for {self.lasts:g} s"

    def slots(self, period_s: float) -> tuple[int, int]:
        """Return the first slot, and the one in which it is over.

        Args:
            period_s: sample period T, s.
        """
        first = round(self.at / period_s)
        return first, max(round((self.at + self.lasts) / period_s), first + (self.kind != RESTART))

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        kind, lasts = values.get("kind"), values.get("lasts", 0.0)
        for key, value in (("at", values.get("at", 0.0)), ("for", lasts)):
            if not 0 <= value <= LONGEST_S:
                yield f"{key}: {value:g} s is not between 0 and {LONGEST_S:g} s"
        named = [key for key in ("link", "node") if values.get(key) is not None]
        of_bits = [key for key in ("rate", "can_id") if values.get(key) is not None]
        if kind == BIT_ERRORS:
            yield from (f"{key}: disturbed bits are seen by all nodes; expected none" for key in named)
            if len(of_bits) != 1:
                yield f"rate: {'both rate and can_id are' if of_bits else 'neither rate nor can_id is'} given; name one of them"
            if not 0.0 < (values.get("rate") or 1.0) <= 1.0:
                yield f"rate: {values['rate']:g}, expected a probability above 0"
            if not 0 <= (values.get("can_id") or 0) < 1 << 29:
                yield f"can_id: {values['can_id']:#x}, expected up to 29 bits"
        else:
            yield from (f"{key}: only a fault of kind 'bit-errors' has one" for key in of_bits)
        if kind == RESTART:
            yield from (f"{key}: a restart of the controller takes none" for key in named)
        elif kind is not None and kind != BIT_ERRORS and len(named) != 1:
            yield f"link: {'both link and node are' if named else 'neither link nor node is'} given; name one of them"
        if kind not in (None, RESTART):
            if "lasts" not in values:
                yield f"for: missing; a fault of kind {kind!r} lasts a while"
            elif lasts == 0:
                yield "for: 0 s, expected more"


class Auth(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A message authentication code in every packet.

    Args:
        key_file: file of the key, mode 0600, as ``hil keys new`` makes it; from where the experiment stands.
    """

    key_file: str


class Tls(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Certificates of both ends, for a link zenoh:tls/HOST:PORT; ``{role}`` in a path is rig or controller.

    Args:
        keys: folder made by ``hil keys new``; stands for the three below.
        ca: certificate of the authority.
        cert: this end's certificate.
        key: its private key, mode 0600.
    """

    keys: str | None = None
    ca: str | None = None
    cert: str | None = None
    key: str | None = None


class Login(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A password for the controller, for a link over zenoh.

    Args:
        users: file of lines NAME:PASSWORD, mode 0600, with one for controller.
    """

    users: str


class OwnMessages(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The CAN messages of a controller that keeps its own: signals of a database as ``MESSAGE.SIGNAL``, or with a factor
    ``MESSAGE.SIGNAL*57.3``, by which the signal is larger than the rig's value.

    Args:
        dbc: the database, from where the experiment stands.
        outputs: by the name of an output the signal that is sent; one without a signal is not sent.
        references: by the name of an output the signal of its reference.
        inputs: by the name of each input the signal that commands it.
        counters: signals that count the frames of their message.
        valid: how long a command stands; without it each answers one sample, and is late where it comes too late.
    """

    dbc: str
    outputs: dict[str, str]
    references: dict[str, str] = {}
    inputs: dict[str, str]
    counters: tuple[str, ...] = ()
    valid: Seconds | None = None


def secured_uri(uri: str, folder: str, auth: Auth | None, tls: Tls | None, login: Login | None) -> str:
    """Return a link's URI with the options that the tables stand for; what the URI says itself is kept.

    Args:
        uri: of the link.
        folder: where the experiment stands, from which paths count.
        auth, tls, login: the tables.

    >>> secured_uri("can:hil:rig0?fd=0", "/lab", Auth(key_file="frames.key"), None, None)
    'can:hil:rig0?fd=0&auth=/lab/frames.key'
    """
    wanted = {"auth": auth.key_file} if auth else {}
    if tls is not None or login is not None:
        traits = traits_of(uri)
        if tls is not None and "tls" in traits.takes and not traits.names_certificates:
            named = {"keys": tls.keys, "ca": tls.ca, "cert": tls.cert, "key": tls.key}
            wanted |= {name: path for name, path in named.items() if path is not None}
        if login is not None and "login" in traits.takes:
            wanted["users"] = login.users
    return with_options(uri, {name: quote(str(Path(folder) / path), safe="/{}") for name, path in wanted.items()})
