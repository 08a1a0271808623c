"""What an experiment is: the tables of its file, frozen, each with the checks of its own fields."""

from __future__ import annotations

import re
import typing
from typing import Any, Literal, get_args

import msgspec

from hil.experiment.nodes import Medium, Node, identifier_faults
from hil.experiment.rig_tables import Auth, Fault, Limits, Login, OwnMessages, Tls, secured_uri
from hil.experiment.table import (
    ControllerTable,
    LawTable,
    PlantTable,
    Seconds,
    Table,
    UnavailablePlugin,
    named_twice,
    not_negative,
    plain,
)
from hil.plugins import registry, written_in
from transport.laws import BoundedAge
from transport.links import TransportError
from transport.links.traits import LinkTable, traits_of

DEFAULT_LINK: typing.Final = "can:hil:rig0"
"""The real link of an experiment that names none: a CAN bus without a kernel's, for the processes of one user."""

HIDDEN = ("text", "kinds", "folder")  # fields of an experiment that are no keys of its file
OLDEST: typing.Final = 63  # slots
SPARSE = ("nodes", "media", "fault")  # fields that the resolved form leaves out where they are empty


class Step(Table, frozen=True, kw_only=True):
    """A step of the reference.

    Args:
        at: when it begins.
        value: reference from then on, one entry per output, in the output's unit.
    """

    at: Seconds
    value: tuple[float, ...]

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        yield from not_negative(values, "at")


class Pulse(Table, frozen=True, kw_only=True):
    """A disturbance added to the plant's input.

    Args:
        at: when it begins.
        samples: how many sample periods it lasts.
        value: what is added, one entry per input, in the input's unit.
    """

    at: Seconds
    samples: int
    value: tuple[float, ...]

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        yield from not_negative(values, "at")
        if values.get("samples", 1) < 1:
            yield f"samples: {values['samples']} is below 1"


class Direction(Table, frozen=True, kw_only=True):
    """One direction of the emulated network.

    Args:
        law: delays, losses and disorder; ``hil laws`` shows what it does.
        max_age: largest delay in samples that the controller's rows cover; by default the law's own bound.
    """

    law: LawTable
    max_age: int

    @staticmethod
    def completed(values: dict[str, Any]) -> dict[str, Any]:
        bound = largest_delay(values)
        return {"max_age": 3 if bound is None else bound} | values

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        age, bound = values.get("max_age", 0), largest_delay(values)
        if age < 0:
            yield f"max_age: {age} is negative"
        elif bound is not None and age < bound:
            yield f"max_age: {age} is below the law's largest delay {bound}"
        elif age > OLDEST:
            yield f"{'law: its largest delay' if age == bound else 'max_age:'} {age} is above {OLDEST}"


def largest_delay(values: typing.Mapping[str, Any]) -> int | None:
    """Return the largest delay of the law among some fields, in slots; None where it has none."""
    law = values.get("law")
    return None if not isinstance(law, BoundedAge) or law.max_age is None else int(law.max_age)


class Network(Table, frozen=True, kw_only=True):
    """The network that is emulated at the rig, on the way to the controller and on the way back.

    Args:
        sc: from the sensor to the controller.
        ca: from the controller to the actuator.
        nodes: sensor nodes by name; without any there is one, which measures every output and sends in every slot.
        media: what nodes share on their way to the controller, by name.
    """

    sc: Direction
    ca: Direction
    nodes: dict[str, Node] = msgspec.field(default_factory=dict)
    media: dict[str, Medium] = msgspec.field(default_factory=dict)

    @staticmethod
    def completed(values: dict[str, Any]) -> dict[str, Any]:
        # A log does not keep the order of tables: the numbers of nodes stand in the resolved form.
        nodes = enumerate(values.get("nodes", {}).items())
        return values | {"nodes": {n: msgspec.structs.replace(t, id=i) if t.id is None else t for i, (n, t) in nodes}}

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        for field in ("nodes", "media"):
            for name in values.get(field, {}):
                if not re.fullmatch(r"[a-z][a-z0-9_]{0,40}", name):
                    yield f"{field}.{name:.60}: expected a letter and up to 40 more: lower-case letters, digits and _"


class Links(Table, frozen=True, kw_only=True):
    """The real link between rig and controller; in virtual time there is none.

    Args:
        uri: the link in real time: can:INTERFACE:CHANNEL, zenoh:ENDPOINT, or local: for the controller in the rig's process.
        auth: a message authentication code in every packet.
        tls: certificates, for a link over zenoh.
        login: a password for the controller, for a link over zenoh.
        messages: CAN messages that an external controller has of its own.
        control_can_id: CAN identifier of the control packets' first frame, 11 bits; by default 0x40 above the link's base.
    """

    uri: str = DEFAULT_LINK
    auth: Auth | None = None
    tls: Tls | None = None
    login: Login | None = None
    messages: OwnMessages | None = None
    control_can_id: int | None = None

    def secured(self, folder: str, uri: str | None = None) -> str:
        """Return the URI of a link, by default the file's own, with the keys that the tables name.

        Args:
            folder: where the experiment stands.
            uri: another link.
        """
        return secured_uri(self.uri if uri is None else uri, folder, self.auth, self.tls, self.login)

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        uri = values.get("uri", DEFAULT_LINK)
        yield from identifier_faults(values, "control_can_id")
        try:
            takes = traits_of(secured_uri(uri, ".", values.get("auth"), None, None)).takes
        except TransportError as error:
            yield f"uri: {error}"
            return
        for table in get_args(LinkTable):
            if values.get(table) is not None and table not in takes:
                kind = "CAN" if table == "messages" else "zenoh"
                yield f"{table}: the link {uri!r:.60} does not take it; only a {kind} link does"


Affinity = Literal["auto", "free", "pinned", "shared"]


class Timing(Table, frozen=True, kw_only=True):
    """How rig and controller run in real time; virtual time reads the deadline only.

    Args:
        deadline: share of the period within which the controller's answer must be here.
        priority: SCHED_FIFO priority of the rig, 1 to 98; the controller runs one below.
        affinity: ``free`` leaves the choice of a CPU to the scheduler, which on a virtual machine evades a CPU that the host has
            taken away; ``pinned`` gives rig and controller one CPU each, counted from the last; ``shared`` gives both, with the
            threads of their link, the last CPU, so that no packet wakes another CPU; ``auto`` is ``shared`` over zenoh, whose
            packets pass through a thread of zenoh's at each end, and ``free`` over other links. ``hil doctor`` measures both.
        idle: ``doze`` leaves idle CPUs to the kernel; ``awake`` keeps all of them from sleeping (/dev/cpu_dma_latency), which
            takes tens of microseconds off every wake-up.
        overrun: what follows a stall: the slots that were missed run back to back, none is skipped.
    """

    deadline: float = 0.6
    priority: int = 60
    affinity: Affinity = "auto"
    idle: Literal["doze", "awake"] = "doze"
    overrun: Literal["catch-up"] = "catch-up"

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        if not 0 < values.get("deadline", 0.6) < 1:
            yield f"deadline: {values['deadline']:g} is not between 0 and 1 (a share of the period)"
        if not 1 <= values.get("priority", 60) <= 98:
            yield f"priority: {values['priority']} is not between 1 and 98"


class Report(Table, frozen=True, kw_only=True):
    """What a run is judged by.

    Args:
        measures: plug-ins whose numbers stand in summary, sweep, comparison and page, in this order.
    """

    measures: tuple[str, ...] = ("tracking",)

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        yield from named_twice(values, "measures")


class Experiment(Table, frozen=True, kw_only=True):
    """One experiment: plant, controller, emulated network, real link, schedule, limits and seed.

    Args:
        name: name of the experiment, and of its logs.
        description: one line for ``hil list``.
        period: sample period T.
        duration: length of a run.
        seed: root of all random streams.
        allow_uncertified: run although the loop has no certificate.
        plant: what is emulated.
        controller: what commands it.
        reference: steps of the reference; 0 before the first.
        disturbance: pulses that are added to the plant's input.
        fault: what breaks when; nothing by default.
        network: the network that is emulated at the rig: network laws, sensor nodes, media.
        links: the real link, for real time.
        limits: what the rig allows, whatever the controller does.
        timing: how rig and controller run in real time.
        report: what a run is judged by.
        kinds: name of the plug-in behind each table.
        text: the file as it was written.
        folder: where the file stands, for the files that it names.
    """

    name: str
    description: str = ""
    period: Seconds
    duration: Seconds
    seed: int = 0
    allow_uncertified: bool = False
    plant: PlantTable
    controller: ControllerTable
    reference: tuple[Step, ...] = ()
    disturbance: tuple[Pulse, ...] = ()
    fault: tuple[Fault, ...] = ()
    network: Network
    links: Links = Links()
    limits: Limits = Limits()
    timing: Timing = Timing()
    report: Report = Report()
    kinds: dict[str, str] = msgspec.field(default_factory=dict)
    text: str = ""
    folder: str = "."

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        name, period, duration = values.get("name", "x"), values.get("period"), values.get("duration")
        if not name or any(c in name for c in "/\\\0"):
            yield f"name: {name!r:.60} is empty or holds a path separator"
        elif not name.isprintable():
            yield f"name: {name!r:.60} holds a control character"
        elif len(name.encode()) > 200:
            yield f"name: has {len(name.encode())} bytes; at most 200, for the log is named after it"
        if period is not None and not 1e-5 <= period <= 60:
            yield f"period: {period:g} s is not between 10 us and 60 s"
        elif period is not None and duration is not None:
            if not duration >= period:  # NaN is no duration either
                yield f"duration: {duration:g} s is shorter than the period {period:g} s"
            elif duration / period > 1e8:
                yield f"duration: {duration / period:.3g} slots; at most 1e8"
        seed = values.get("seed", 0)
        if not 0 <= seed < 2**63 and seed.bit_length() <= 64:  # what is longer is refused wherever it stands
            yield f"seed: {seed} is not between 0 and 2^63 - 1"

    @property
    def period_ns(self) -> int:
        """Sample period, ns."""
        return round(self.period * 1e9)

    @property
    def slots(self) -> int:
        """Number of slots."""
        return round(self.duration / self.period)

    def resolved(self) -> dict[str, Any]:
        """Return the experiment with every default written out, as plain JSON values."""
        out: dict[str, Any] = {}
        for f in self.__struct_fields__:
            value = getattr(self, f)
            if f not in HIDDEN and (value or f not in SPARSE):
                out[f] = plain(value)
        out["network"] = {name: table for name, table in out["network"].items() if table or name not in SPARSE}
        for path in self.kinds:
            node = out
            for part in path.split("."):
                node[part] = node[part] if isinstance(node[part], dict) else {}  # an object that is no dataclass has no table
                node = node[part]
            node["kind"] = self._made(path)[1]
        return out

    def _made(self, path: str) -> tuple[Any, str]:
        """Return what stands at the path of a plug-in's table, and its kind."""
        made: Any = self
        for part in path.split("."):
            made = made[part] if isinstance(made, dict) else getattr(made, part)
        said = self.kinds.get(path, "")
        return made, said if isinstance(made, UnavailablePlugin) else registry.kind_of(registry.group_of(path), said, made)

    def origins(self) -> dict[str, str]:
        """Return where plant, controller and network laws come from, in words, where the experiment file does not make them."""
        found = {}
        for path in dict.fromkeys(("plant", "controller", *self.kinds)):
            made, kind = self._made(path)
            own = written_in(type(made))
            if kind.startswith(registry.OBJECT):
                found[path] = f"{kind} (not in the experiment file)"
            elif own is not None:
                found[path] = f"{kind} of {own[0]}, SHA-256 {own[1]}..."
        return found
