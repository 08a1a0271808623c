"""Raw TOML to a checked experiment: table by table, plug-in by plug-in, so that no fault hides another.

A network law may stand in a file of its own, as `hil identify law` writes one: ``law = { file = "law.toml" }``. Keys beside
``file`` replace those of the file: ``law = { file = "law.toml", loss = 0.1 }``, or ``--set network.sc.law.loss=0.1``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hil.errors import HilError
from hil.experiment.table import UnavailablePlugin
from hil.experiment.table_check import INFINITE, TableCheck, fault_at, infinite_faults
from hil.experiment.tables import HIDDEN, Experiment
from hil.files import read_regular
from hil.files.toml_text import parse_toml
from hil.plugins import is_own, registry
from hil.plugins.registry import OBJECT
from hil.plugins.user_plugins import in_own_words, own_fault
from plants.errors import PlantError
from plants.parts.protocols import ReferencesFiles
from transport.errors import FieldError
from transport.laws import load_files

MAX_BYTES = 1_000_000
BESIDE = "fit"
"""The table of a law's file that says how it was found; a run does not read it."""


def read_law_file(name: Any, folder: str) -> dict[str, Any]:
    """Return the table of a network law from a file.

    Args:
        name: the file; a relative one counts from the folder.
        folder: where the experiment stands.

    Raises:
        FieldError: it is no text, cannot be read, is no TOML, or has no law.
    """
    if not isinstance(name, str):
        raise FieldError("file", f"expected the name of a law's file, got {name!r:.60}")
    path = Path(folder) / name
    try:
        table = parse_toml(read_regular(path, MAX_BYTES, "a file of a network law").decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise FieldError("file", f"{path}: is no text") from None
    except ValueError as error:
        raise FieldError("file", f"{path}: not valid TOML: {error}") from error
    except HilError as error:
        raise FieldError("file", f"{error}") from error
    table.pop(BESIDE, None)
    if not isinstance(table.get("kind"), str):
        raise FieldError("file", f"{path}: kind: missing; expected a network law, as `hil identify law` writes one")
    return table


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
        self._tables = TableCheck(folder, self._made, objects or {})
        self.faults = self._tables.faults
        self.kinds: dict[str, str] = {}
        self._folder = folder
        self._objects = objects or {}

    def experiment(self, raw: dict[str, Any], text: str) -> Experiment | None:
        self.faults += infinite_faults(raw, "")
        folder = self._folder or "."
        if self._folder is None:
            raw = _without_own_measures(raw)
        given: dict[str, Any] = {"text": text, "folder": folder, "kinds": self.kinds}
        for reserved in HIDDEN:
            if reserved in raw:
                self.faults.append(f"{reserved}: unknown field")
        rest = {k: v for k, v in raw.items() if k not in given}
        experiment = self._tables.table(Experiment, rest, "", given)
        if isinstance(experiment, Experiment):
            for i, name in enumerate(experiment.report.measures):
                with self._kept(f"report.measures[{i}]", HilError):
                    registry.load("hil.measures", name, folder)
        infinite = {fault.partition(": ")[0] for fault in self.faults if fault.endswith(INFINITE)}
        self.faults[:] = [f for f in self.faults if f.endswith(INFINITE) or f.partition(": ")[0] not in infinite]  # say it once
        return experiment if not self.faults else None

    @contextmanager
    def _kept(self, path: str, *kinds: type[Exception]) -> Iterator[None]:
        """Keep what goes wrong in the block as the fault of a path."""
        try:
            yield
        except kinds as error:
            self.faults.append(fault_at(path, error))

    def _made(self, group: registry.Group, raw: Any, path: str) -> Any:
        """Return what fills the table of a plug-in, a network law with the files that it names read."""
        if group != "hil.laws":
            return self.plugin(group, raw, path)
        with self._kept(path, ValueError):
            if isinstance(raw, dict) and "file" in raw and "kind" not in raw and self._folder is not None:
                raw = read_law_file(raw["file"], self._folder) | {key: value for key, value in raw.items() if key != "file"}
            return load_files(self.plugin(group, raw, path), self._folder or ".")
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
        with self._kept(f"{path}: {kind!r}", AssertionError), in_own_words():
            made = self._filled(cls, kind, rest, path)
            return made if made is None or self._sound(group, made, path, repr(kind)) else None
        return None

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
        with self._kept(path, ValueError, PlantError):
            return made.with_files(folder)
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
