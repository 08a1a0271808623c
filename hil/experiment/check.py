"""Raw TOML to a checked experiment: table by table, plug-in by plug-in, so that no fault hides another.

A network law may stand in a file of its own, as `hil identify law` writes one: ``law = { file = "law.toml" }``.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from hil.errors import HilError
from hil.experiment.nodes import Medium, Node
from hil.experiment.table import UnavailablePlugin
from hil.experiment.table_check import INFINITE, TableCheck, fault_at, infinite_faults
from hil.experiment.tables import HIDDEN, Direction, Experiment, Network
from hil.files import read_regular
from hil.files.toml_text import parse_toml
from hil.plugins import is_own, registry
from hil.plugins.registry import OBJECT
from hil.plugins.user_plugins import in_own_words, own_fault
from plants.errors import PlantError
from plants.parts.protocols import ReferencesFiles
from transport.laws import BoundedAge, load_files

MAX_BYTES = 1_000_000
BESIDE = "fit"
"""The table of a law's file that says how it was found; a run does not read it."""


def read_law_file(name: Any, folder: str) -> dict[str, Any]:
    """Return the table of a network law from a file.

    Args:
        name: the file; a relative one counts from the folder.
        folder: where the experiment stands.

    Raises:
        HilError: it is no text, cannot be read, is no TOML, or has no law.
    """
    if not isinstance(name, str):
        raise HilError(f"file: expected the name of a law's file, got {name!r:.60}")
    path = Path(folder) / name
    try:
        table = parse_toml(read_regular(path, MAX_BYTES, "a file of a network law").decode())
    except UnicodeDecodeError:
        raise HilError(f"file: {path}: is no text") from None
    except ValueError as error:
        raise HilError(f"file: {path}: not valid TOML: {error}") from error
    except HilError as error:
        raise HilError(f"file: {error}") from error
    table.pop(BESIDE, None)
    if not isinstance(table.get("kind"), str):
        raise HilError(f"file: {path}: kind: missing; expected a network law, as `hil identify law` writes one")
    return table


OLDEST = 63  # slots


def _without_own_measures(raw: dict[str, Any]) -> dict[str, Any]:
    """Return an experiment of a log without the measures whose modules it names: reading a log runs none."""
    report = raw.get("report")
    names = report.get("measures") if isinstance(report, dict) else None
    if not isinstance(names, list):
        return raw
    return raw | {"report": {**report, "measures": [n for n in names if not (isinstance(n, str) and is_own(n))]}}  # type: ignore[dict-item]


class Checker:
    """Makes an experiment table by table, so that no fault hides another.

    Args:
        folder: where the files stand that the experiment names; None for one that a log carries: no file is read, and no module
            run, because a log says so.
        objects: what stands for the table of a plant, a controller or a network law, by its path.
    """

    def __init__(self, folder: str | None = ".", objects: Mapping[str, object] | None = None) -> None:
        self._tables = TableCheck(folder)
        self.faults = self._tables.faults
        self.kinds: dict[str, str] = {}
        self._folder = folder
        self._objects = objects or {}

    def experiment(self, raw: dict[str, Any], text: str) -> Experiment | None:
        self.faults += infinite_faults(raw, "")
        folder = self._folder or "."
        if self._folder is None:
            raw = _without_own_measures(raw)
        given: dict[str, Any] = {
            "plant": self.plugin("hil.plants", raw.get("plant"), "plant"),
            "controller": self.plugin("hil.controllers", raw.get("controller"), "controller"),
            "network": self._network(raw.get("network"), folder),
            "text": text,
            "folder": folder,
            "kinds": self.kinds,
        }
        for reserved in HIDDEN:
            if reserved in raw:
                self.faults.append(f"{reserved}: unknown field")
        rest = {k: v for k, v in raw.items() if k not in given}
        experiment = self._tables.table(Experiment, rest, "", given)
        if isinstance(experiment, Experiment):
            self._own_measures(experiment, folder)
        infinite = {fault.partition(": ")[0] for fault in self.faults if fault.endswith(INFINITE)}
        self.faults[:] = [f for f in self.faults if f.endswith(INFINITE) or f.partition(": ")[0] not in infinite]  # say it once
        return experiment if not self.faults else None

    def _network(self, raw: Any, folder: str) -> Network | None:
        if raw is None:
            self.faults.append("network: missing table; it has sc.law and ca.law")
            return None
        if not isinstance(raw, dict):
            self.faults.append(f"network: expected a table, got {raw!r:.60}")
            return None
        given: dict[str, Any] = {
            "nodes": self._nodes(raw.get("nodes", {}), folder),
            "media": self._named(Medium, raw.get("media", {}), "network.media", lambda table, path: {}),
        }
        for side in ("sc", "ca"):
            table = raw.get(side)
            if not isinstance(table, dict):
                self.faults.append(f"network.{side}: missing table" if table is None else f"network.{side}: expected a table")
                given[side] = None
                continue
            law = self._law(table.get("law"), f"network.{side}.law", folder)
            bound = law.max_age if isinstance(law, BoundedAge) else None
            default = 3 if bound is None else int(bound)
            direction = self._tables.table(
                Direction, {"max_age": default} | {k: v for k, v in table.items() if k != "law"}, f"network.{side}", {"law": law}
            )
            if direction is not None and law is not None:
                if direction.max_age < 0:
                    self.faults.append(f"network.{side}.max_age: {direction.max_age} is negative")
                elif bound is not None and direction.max_age < bound:
                    self.faults.append(f"network.{side}.max_age: {direction.max_age} is below the law's largest delay {bound}")
                elif direction.max_age > OLDEST:
                    field = "max_age:" if "max_age" in table else "law: its largest delay"
                    self.faults.append(f"network.{side}.{field} {direction.max_age} is above {OLDEST}")
            given[side] = direction
        network: Network | None = self._tables.table(Network, {k: v for k, v in raw.items() if k not in given}, "network", given)
        return network

    def _nodes(self, raw: Any, folder: str) -> dict[str, Any] | None:
        """Return the sensor nodes, each with the network law that it names."""

        def law(table: dict[str, Any], path: str) -> dict[str, Any]:
            named = "law" in table or f"{path}.law" in self._objects
            return {"law": self._law(table.get("law"), f"{path}.law", folder)} if named else {}

        found = self._named(Node, raw, "network.nodes", law)
        if found is None:
            return None
        # A log does not keep the order of tables: their numbers stand in the resolved form.
        numbered = enumerate(found.items())
        return {n: msgspec.structs.replace(t, id=i) if t is not None and t.id is None else t for i, (n, t) in numbered}

    def _named(
        self, cls: type, raw: Any, table_path: str, plugin_fields: Callable[[dict[str, Any], str], dict[str, Any]]
    ) -> dict[str, Any] | None:
        """Return the tables of one kind by name; `plugin_fields` makes the fields that are plug-ins."""
        if not isinstance(raw, dict):
            self.faults.append(f"{table_path}: expected a table, got {raw!r:.60}")
            return None
        found: dict[str, Any] = {}
        for name, table in raw.items():
            path = f"{table_path}.{name:.60}"
            if not re.fullmatch(r"[a-z][a-z0-9_]{0,40}", name):
                self.faults.append(f"{path}: expected a name of lower-case letters, digits and _")
            elif not isinstance(table, dict):
                self.faults.append(f"{path}: expected a table, got {table!r:.60}")
            else:
                given = plugin_fields(table, path)
                found[name] = self._tables.table(cls, {k: v for k, v in table.items() if k not in given}, path, given)
        return found

    def _law(self, raw: Any, path: str, folder: str) -> Any:
        """Return a network law with the files that it names read, from where the experiment stands."""
        if isinstance(raw, dict) and raw.keys() == {"file"} and self._folder is not None:
            try:
                raw = read_law_file(raw["file"], folder)
            except HilError as e:
                self.faults.append(f"{path}.{e}")
                return None
        law = self.plugin("hil.laws", raw, path)
        try:
            return load_files(law, folder)
        except ValueError as e:
            self.faults.append(fault_at(path, e))
            return None

    def plugin(self, group: registry.Group, raw: Any, path: str) -> Any:
        if path in self._objects:
            return self._object(group, self._objects[path], path)
        if not isinstance(raw, dict):
            said = f"expected a table, got {raw!r:.60}"
            if isinstance(raw, str) and raw in registry.names(group):
                said += f"; as a table: {{ kind = {raw!r} }}"
            self.faults.append(f"{path}: missing table" if raw is None else f"{path}: {said}")
            return None
        kind = raw.get("kind")
        if not isinstance(kind, str):
            self.faults.append(f"{path}.kind: missing; one of {', '.join(registry.names(group))}")
            return None
        rest = {k: v for k, v in raw.items() if k != "kind"}
        if kind.startswith(OBJECT) or (self._folder is None and is_own(kind)):
            return self._absent(path, kind, rest)
        try:
            cls = registry.load(group, kind, self._folder or ".")
            if is_own(kind) and not (isinstance(cls, type) and dataclasses.is_dataclass(cls)):
                raise HilError(f"{kind!r} is no dataclass; write @dataclass above it: its fields are the keys of this table")
        except HilError as e:
            self.faults.append(f"{path}.kind: {e}")
            return None
        self.kinds[path] = kind
        if not is_own(kind):
            return self._filled(cls, kind, rest, path)
        try:
            with in_own_words():
                made = self._filled(cls, kind, rest, path)
        except AssertionError as e:
            self.faults.append(f"{path}: {kind!r}: {e}")
            return None
        return made if made is None or self._sound(group, made, path, repr(kind)) else None

    def _object(self, group: registry.Group, made: object, path: str) -> Any:
        """Return an object of Python that stands for a table; None: what it lacks is kept.

        That of an installed class is what its table would make, and has its kind; any other has the kind
        ``object my_module.Cart``, and a log of it needs the object to run again.
        """
        if isinstance(made, type):
            self.faults.append(f"{path}: the class {made.__name__}, expected an object of it: {path}={made.__name__}()")
            return None
        cls = type(made)
        installed = registry.kind_of_class(group, cls)
        self.kinds[path] = installed or registry.object_kind(cls)
        if installed is None and not self._sound(group, made, path, f"{cls.__module__}.{cls.__qualname__}"):
            return None
        return self._with_files(made, path, self._folder or ".") if isinstance(made, ReferencesFiles) else made

    def _with_files(self, made: ReferencesFiles, path: str, folder: str) -> ReferencesFiles | None:
        try:
            return made.with_files(folder)
        except (ValueError, PlantError) as e:
            self.faults.append(fault_at(path, e))
            return None

    def _sound(self, group: registry.Group, plugin: object, path: str, kind: str) -> bool:
        """Return whether an object of the user's own is what its place asks for; what it is not is kept as a fault."""
        fault = own_fault(group, plugin)
        if fault is not None:
            self.faults.append(f"{path}: {kind}: {fault}")
        return fault is None

    def _filled(self, cls: type, kind: str, rest: dict[str, Any], path: str) -> Any:
        """Return an instance of a plug-in's class, with the files that it names found; None: what is faulty is kept."""
        made = self._tables.table(cls, rest, path, {})
        if not isinstance(made, ReferencesFiles):
            return made
        return self._absent(path, kind, rest) if self._folder is None else self._with_files(made, path, self._folder)

    def _absent(self, path: str, kind: str, table: dict[str, Any]) -> UnavailablePlugin | None:
        """Return what stands for something that a log cannot make again."""
        if self._folder is not None or path not in ("plant", "controller"):
            helps = "give the object in Python" + (" (hil.verify(..., laws={...}))" if path.endswith("law") else "")
            helps = "say where its file stands (--folder DIR)" if is_own(kind) and self._folder is None else helps
            self.faults.append(f"{path}.kind: {kind!r} cannot be made from a log or an experiment file; {helps}")
            return None
        self.kinds[path] = kind
        why = f"{kind}, which the log does not hold"
        return UnavailablePlugin(field=path, kind=kind, why=why, said=table)

    def _own_measures(self, experiment: Experiment, folder: str) -> None:
        for i, name in enumerate(experiment.report.measures):
            try:
                registry.load("hil.measures", name, folder)
            except HilError as error:
                self.faults.append(f"report.measures[{i}]: {error}")
