"""TOML to a checked, frozen description of an experiment; every fault is reported at once, by its path."""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
import tomllib
import typing
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import msgspec

from hil import registry
from hil.errors import ExperimentError, HilError

MAX_BYTES = 1_000_000
HIDDEN = ("text", "kinds", "folder")  # fields of an experiment that are no keys of its file
FIELD = re.compile(r"[a-z_]\w*(\[\d+\])*(\.\w+)*: ")
UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}


class Seconds(float):
    """A duration: a bare number in seconds or a string with a unit, ``"50 ms"``."""

    @classmethod
    def parse(cls, value: object) -> Seconds:
        """Return the duration in seconds.

        >>> Seconds.parse("50 ms"), Seconds.parse(2)
        (0.05, 2.0)
        """
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise ValueError(f"expected a duration such as '50 ms' or 0.05, got {value!r}")
        if not isinstance(value, str):
            return cls(value)
        number, _, unit = value.strip().partition(" ")
        scale = UNITS.get(unit.strip() or "s")
        try:
            if scale is None:
                raise ValueError
            return cls(float(number) * scale)
        except ValueError:
            raise ValueError(f"{value!r} is not a duration: write a number and one of {', '.join(UNITS)}") from None


class Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of every table of an experiment file.

    ``faults(values)`` checks the fields that could be converted, whether or not the others could.
    """

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        """Yield ``field: what is wrong``."""
        yield from ()


def _not_negative(values: typing.Mapping[str, Any], field: str) -> typing.Iterator[str]:
    if values.get(field, 0.0) < 0:
        yield f"{field}: {values[field]:g} s is negative"


class Step(Table, frozen=True, kw_only=True):
    """From ``at`` on, the reference is ``value`` (one entry per output)."""

    at: Seconds
    value: tuple[float, ...]

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        yield from _not_negative(values, "at")


class Pulse(Table, frozen=True, kw_only=True):
    """A disturbance added to the plant's input from ``at`` on, for ``samples`` sample periods."""

    at: Seconds
    samples: int
    value: tuple[float, ...]

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        yield from _not_negative(values, "at")
        if values.get("samples", 1) < 1:
            yield f"samples: {values['samples']} is below 1"


class Direction(Table, frozen=True, kw_only=True):
    """One direction of the emulated network.

    ``max_age`` is the largest delay in samples that the controller's rows cover; by default the law's own bound.
    """

    law: Any
    max_age: int

    @property
    def kind(self) -> str:
        """Name of the law's class, for messages."""
        return type(self.law).__name__


class Links(Table, frozen=True, kw_only=True):
    """The real link, and the network that is emulated on both sides of the rig."""

    uri: str
    sc: Direction
    ca: Direction


class Limits(Table, frozen=True, kw_only=True):
    """What the rig allows, whatever the controller does; a violation latches the safe state (zero input).

    ``input`` and ``state`` are absolute bounds per input and per named state; ``watchdog_ticks`` slots without a usable
    command trip the watchdog; ``after_trip`` is how long the rig goes on in the safe state before the run ends.
    """

    watchdog_ticks: int = 3
    input: tuple[float, ...] | None = None
    state: dict[str, float] = msgspec.field(default_factory=dict)
    after_trip: Seconds = typing.cast(Seconds, 1.0)  # a plain float, for the JSON Schema

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        if values.get("watchdog_ticks", 1) < 1:
            yield f"watchdog_ticks: {values['watchdog_ticks']} is below 1"
        for i, bound in enumerate(values.get("input") or ()):
            if bound <= 0:
                yield f"input[{i}]: {bound:g} is not positive"
        for name, bound in values.get("state", {}).items():
            if bound <= 0:
                yield f"state.{name}: {bound:g} is not positive"
        yield from _not_negative(values, "after_trip")


class Timing(Table, frozen=True, kw_only=True):
    """Real time only: ``deadline`` is the share of the period within which the controller's answer must be here.

    ``affinity``: ``free`` leaves the choice of a CPU to the scheduler, which on a virtual machine evades a CPU that the host
    has taken away; ``pinned`` gives rig and controller one CPU each, counted from the last.
    """

    deadline: float = 0.6
    priority: int = 60
    affinity: Literal["free", "pinned"] = "free"
    overrun: Literal["catch-up"] = "catch-up"

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        if not 0 < values.get("deadline", 0.6) < 1:
            yield f"deadline: {values['deadline']:g} is not between 0 and 1 (a share of the period)"
        if not 1 <= values.get("priority", 60) <= 98:
            yield f"priority: {values['priority']} is not between 1 and 98"


class Experiment(Table, frozen=True, kw_only=True):
    """One experiment: plant, controller, links with their network laws, schedule, limits and seed."""

    name: str
    description: str = ""
    period: Seconds
    duration: Seconds
    seed: int = 0
    allow_uncertified: bool = False
    plant: Any
    controller: Any
    reference: tuple[Step, ...] = ()
    disturbance: tuple[Pulse, ...] = ()
    links: Links
    limits: Limits = Limits()
    timing: Timing = Timing()
    kinds: dict[str, str] = msgspec.field(default_factory=dict)  # table -> name of its plug-in
    text: str = ""  # the file as it was written
    folder: str = "."  # where it stands, for the files that it names

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        name, period, duration = values.get("name", "x"), values.get("period"), values.get("duration")
        if not name or any(c in name for c in "/\\\0"):
            yield f"name: {name!r} is empty or holds a path separator"
        if period is not None and not 1e-5 <= period <= 60:
            yield f"period: {period:g} s is not between 10 us and 60 s"
        elif period is not None and duration is not None:
            if duration < period:
                yield f"duration: {duration:g} s is shorter than the period {period:g} s"
            elif duration / period > 1e8:
                yield f"duration: {duration / period:.3g} ticks; at most 1e8"
        if not 0 <= values.get("seed", 0) < 2**63:
            yield f"seed: {values['seed']} is not between 0 and 2^63 - 1"

    @property
    def period_ns(self) -> int:
        """Sample period, ns."""
        return round(self.period * 1e9)

    @property
    def ticks(self) -> int:
        """Number of slots."""
        return round(self.duration / self.period)

    def resolved(self) -> dict[str, Any]:
        """Return the experiment with every default written out, as plain JSON values."""
        out: dict[str, Any] = {}
        for f in self.__struct_fields__:
            if f not in HIDDEN:
                out[f] = _plain(getattr(self, f))
        for path, kind in self.kinds.items():
            node = out
            for part in path.split("."):
                node = node[part]
            node["kind"] = kind
        return out


def shipped() -> dict[str, Path]:
    """Return the experiments that come with the package, by name."""
    folder = Path(str(resources.files("hil"))) / "experiments"
    return {p.stem: p for p in sorted(folder.glob("*.toml"))}


def load_experiment(source: str | Path, sets: typing.Sequence[str] = ()) -> Experiment:
    """Read and check an experiment.

    Parameters
    ----------
    source : str or Path
        Name of a shipped experiment, or path of a TOML file.
    sets : sequence of str
        Changes ``path=value``, value in TOML notation (a bare word is taken as a string).

    Raises
    ------
    ExperimentError
        With every fault found, each with the path of its field.
    """
    name = str(source)
    path = shipped().get(name, Path(source))
    if not path.exists():
        near = difflib.get_close_matches(name, shipped(), n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise HilError(f"no experiment {name!r}: neither a file nor a shipped name; {hint}(`hil list` shows them)")
    if path.is_dir():
        raise HilError(f"{name}: is a folder, not an experiment file")
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise HilError(f"{name}: {size} bytes; an experiment file has at most {MAX_BYTES}")
        data = path.read_bytes()
    except OSError as e:
        raise HilError(f"{name}: cannot be read: {e.strerror}") from e
    try:
        text = data.decode()
    except UnicodeDecodeError as e:
        raise HilError(f"{name}: not a text file: byte 0x{data[e.start]:02x} at offset {e.start} is not UTF-8") from e
    return parse_experiment(text, sets=sets, source=name, folder=str(path.parent))


def parse_experiment(
    text: str, *, sets: typing.Sequence[str] = (), source: str = "experiment", folder: str = "."
) -> Experiment:
    """Check the text of an experiment; see :func:`load_experiment`."""
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as e:
        raise HilError(f"{source}: not valid TOML: {e}") from e
    except RecursionError as e:
        raise HilError(f"{source}: not valid TOML: nested too deeply") from e
    for change in sets:
        _apply(raw, change)
    checker = _Checker()
    try:
        experiment = checker.experiment(raw, text, folder)
    except RecursionError as e:
        raise HilError(f"{source}: not valid TOML: nested too deeply") from e
    if checker.faults or experiment is None:
        raise ExperimentError(source, checker.faults)
    return experiment


def experiment_from_resolved(resolved: typing.Mapping[str, Any], text: str, source: str) -> Experiment:
    """Check the resolved form that a log carries, so that what ran can run again."""
    checker = _Checker()
    experiment = checker.experiment(_without_none(resolved), text)
    if checker.faults or experiment is None:
        raise ExperimentError(f"{source}: resolved experiment", checker.faults)
    return experiment


def parse_plugin(group: registry.Group, kind: str, sets: typing.Sequence[str] = ()) -> Any:
    """Make the parameters of one plug-in from ``key=value`` changes, as the table of an experiment file would."""
    raw: dict[str, Any] = {}
    for change in sets:
        _apply(raw, change)
    checker = _Checker()
    checker._finite(raw, "")
    made = checker._plugin(group, {"kind": kind, **raw}, group.removeprefix("hil.").removesuffix("s"))
    if checker.faults:
        raise HilError("\n".join(checker.faults))
    return made


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    return [_without_none(v) for v in value] if isinstance(value, list) else value


def _apply(raw: dict[str, Any], change: str) -> None:
    path, eq, value = change.partition("=")
    keys = path.strip().split(".")
    if not eq or not all(keys):
        raise HilError(f"--set {change!r}: expected path=value, such as plant.gain=170")
    try:
        parsed = tomllib.loads(f"v = {value}")["v"]
    except tomllib.TOMLDecodeError:
        parsed = value.strip()
    node: Any = raw
    for i, key in enumerate(keys):
        at = ".".join(keys[:i])
        if isinstance(node, list):
            if not key.isdigit() or int(key) >= len(node):
                raise HilError(f"--set {change!r}: {at} has entries 0 to {len(node) - 1}, not {key!r}")
            index: Any = int(key)
        elif isinstance(node, dict):
            index = key
        else:
            raise HilError(f"--set {change!r}: {at} is a value, not a table")
        if i == len(keys) - 1:
            node[index] = parsed
        else:
            node = node.setdefault(index, {}) if isinstance(node, dict) else node[index]


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value) if f.init}
    if isinstance(value, msgspec.Struct):
        config = value.__struct_config__
        tag = {config.tag_field: config.tag} if config.tag_field else {}
        return tag | {f: _plain(getattr(value, f)) for f in value.__struct_fields__}
    if isinstance(value, tuple | list):
        return [_plain(v) for v in value]
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    return float(value) if isinstance(value, Seconds) else value


def _hook(kind: type, value: object) -> object:
    if kind is Seconds:
        return Seconds.parse(value)
    raise NotImplementedError(kind)


def _join(path: str, rest: str) -> str:
    return f"{path}.{rest}" if path and not rest.startswith("[") else path + rest


class _Checker:
    """Converts table by table and field by field, so that no fault hides another."""

    def __init__(self) -> None:
        self.faults: list[str] = []
        self.kinds: dict[str, str] = {}

    def experiment(self, raw: dict[str, Any], text: str, folder: str = ".") -> Experiment | None:
        self._finite(raw, "")
        links = raw.get("links")
        given: dict[str, Any] = {
            "plant": self._plugin("hil.plants", raw.get("plant"), "plant"),
            "controller": self._plugin("hil.controllers", raw.get("controller"), "controller"),
            "links": self._links(links),
            "text": text,
            "folder": folder,
            "kinds": self.kinds,
        }
        for reserved in HIDDEN:
            if reserved in raw:
                self.faults.append(f"{reserved}: unknown field")
        rest = {k: v for k, v in raw.items() if k not in given}
        experiment = self.table(Experiment, rest, "", given)
        return experiment if not self.faults else None

    def _links(self, raw: Any) -> Links | None:
        if raw is None:
            self.faults.append("links: missing table")
            return None
        if not isinstance(raw, dict):
            self.faults.append(f"links: expected a table, got {raw!r:.60}")
            return None
        given: dict[str, Any] = {}
        for side in ("sc", "ca"):
            table = raw.get(side)
            if not isinstance(table, dict):
                self.faults.append(f"links.{side}: missing table" if table is None else f"links.{side}: expected a table")
                given[side] = None
                continue
            law = self._plugin("hil.laws", table.get("law"), f"links.{side}.law")
            bound = getattr(law, "max_age", None)
            default = 3 if bound is None else int(bound)
            direction = self.table(
                Direction, {"max_age": default} | {k: v for k, v in table.items() if k != "law"}, f"links.{side}", {"law": law}
            )
            if direction is not None and law is not None:
                if direction.max_age < 0:
                    self.faults.append(f"links.{side}.max_age: {direction.max_age} is negative")
                elif bound is not None and direction.max_age < bound:
                    self.faults.append(f"links.{side}.max_age: {direction.max_age} is below the law's largest delay {bound}")
                elif direction.max_age > 63:
                    self.faults.append(f"links.{side}.max_age: {direction.max_age} is above 63")
            given[side] = direction
        links: Links | None = self.table(Links, {k: v for k, v in raw.items() if k not in given}, "links", given)
        return links

    def _plugin(self, group: registry.Group, raw: Any, path: str) -> Any:
        if not isinstance(raw, dict):
            self.faults.append(f"{path}: missing table" if raw is None else f"{path}: expected a table, got {raw!r:.60}")
            return None
        kind = raw.get("kind")
        if not isinstance(kind, str):
            self.faults.append(f"{path}.kind: missing; one of {', '.join(registry.names(group))}")
            return None
        try:
            cls = registry.load(group, kind)
        except HilError as e:
            self.faults.append(f"{path}.kind: {e}")
            return None
        self.kinds[path] = kind
        return self.table(cls, {k: v for k, v in raw.items() if k != "kind"}, path, {})

    def table(self, cls: type, raw: dict[str, Any], path: str, given: dict[str, Any]) -> Any:
        """Convert one table into ``cls``; ``given`` holds fields that were made elsewhere (None: faulty there)."""
        hints = typing.get_type_hints(cls)
        if issubclass(cls, msgspec.Struct):
            required = {f.name for f in msgspec.structs.fields(cls) if f.required}
            known = list(cls.__struct_fields__)
        else:
            fs = [f for f in dataclasses.fields(cls) if f.init]  # type: ignore[arg-type]
            required = {f.name for f in fs if f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING}
            known = [f.name for f in fs]
        before, values, broken = len(self.faults), dict(given), set(given)
        for key, value in raw.items():
            at = _join(path, key)
            if key not in known:
                near = difflib.get_close_matches(key, known, n=1)
                self.faults.append(f"{at}: unknown field" + (f"; did you mean {near[0]!r}?" if near else ""))
                continue
            count = len(self.faults)
            converted = self._value(hints[key], value, at)
            if len(self.faults) == count:
                values[key] = converted
            else:
                broken.add(key)
        for key in known:
            if key in required and key not in values and key not in broken:
                self.faults.append(f"{_join(path, key)}: missing")
        if issubclass(cls, Table):
            self.faults += [_join(path, fault) for fault in cls.faults(values)]
        if len(self.faults) > before or any(v is None for v in given.values()):
            return None
        try:
            return cls(**values)
        except (ValueError, TypeError) as e:
            self.faults.append(_join(path, str(e)) if path else str(e))
            return None

    def _value(self, hint: Any, value: Any, at: str) -> Any:
        if isinstance(hint, type) and isinstance(value, dict) and (
            issubclass(hint, msgspec.Struct) or dataclasses.is_dataclass(hint)
        ):
            return self.table(hint, value, at, {})
        args = typing.get_args(hint)
        if typing.get_origin(hint) is tuple and isinstance(value, list) and len(args) == 2 and args[1] is ...:
            return tuple(self._value(args[0], v, f"{at}[{i}]") for i, v in enumerate(value))
        try:
            return msgspec.convert(value, hint, dec_hook=_hook)
        except (msgspec.ValidationError, ValueError) as e:
            message, _, where = str(e).partition(" - at `$")
            sub = where.rstrip("`")
            own = FIELD.match(message) is not None  # one of our classes said it, and named its field
            self.faults.append(_join(at, message) if own else f"{at}{sub}: {message[0].lower()}{message[1:]}")
            return None

    def _finite(self, value: Any, at: str) -> None:
        if isinstance(value, float) and not math.isfinite(value):
            self.faults.append(f"{at}: {value} is not a finite number")
        elif isinstance(value, dict):
            for k, v in value.items():
                self._finite(v, _join(at, str(k)))
        elif isinstance(value, list):
            for i, v in enumerate(value):
                self._finite(v, f"{at}[{i}]")
