"""A plant in a functional mock-up unit: FMI 2 or 3 for co-simulation, run by FMPy (``pip install 'hilrig[fmu]'``)."""

from __future__ import annotations

import re
import tempfile
import weakref
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np

from plants.errors import FieldError, PlantError
from plants.parts.exponential import Rows
from plants.parts.linear import NS_PER_S, Signal, StateSpace
from plants.parts.validation import require_rows

MOST_BYTES: Final = 500_000_000
MOST_FILES: Final = 10_000
_NO_LETTER: Final = re.compile(r"[^a-z0-9_]+")


@dataclass(frozen=True, slots=True, kw_only=True)
class Unit:
    """What was found in a file: where it is, and the variables that the rig uses.

    Args:
        path: of the file.
        version: 2 or 3.
        identifier: name of its library.
        token: GUID or instantiation token.
        references: value references of what is commanded, measured and logged.
        parameters: value references and values of the parameters.
        signals: names and units of what is commanded, measured and logged.
    """

    path: str
    version: int
    identifier: str
    token: str
    references: tuple[tuple[int, ...], ...]
    parameters: tuple[tuple[int, ...], tuple[float, ...]]
    signals: tuple[tuple[Signal, ...], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class FMU:
    """A plant that a functional mock-up unit computes, by co-simulation: native code of the file runs in the rig.

    The rig steps it from slot to slot under a held input. Whether two steps are one of their sum is the unit's own affair; A, B
    and C are what a controller is told of it, and no claim on them is a claim on the unit.

    It needs FMPy: pip install 'hilrig[fmu]'.

    Args:
        file: the .fmu, relative to the experiment.
        A: n rows of n entries: linear model around the operating point.
        B: n rows of m entries.
        C: p rows of n entries.
        commanded: variables of the unit that take the m inputs; all its inputs, in its order, if left out.
        measured: variables that are the p outputs; all its outputs if left out.
        logged: further variables that the log keeps as the state; the measured ones if left out.
        parameters: variable to its value from the start.
        sha256: of the file; filled in when it is read, and then no other file is taken for it.

    Raises:
        ValueError: where a shape does not fit.

    Reference: FMI 2.0.5 and FMI 3.0.2, Modelica Association.
    """

    file: str
    A: Rows
    B: Rows
    C: Rows
    commanded: tuple[str, ...] = ()
    measured: tuple[str, ...] = ()
    logged: tuple[str, ...] = ()
    parameters: dict[str, float] = field(default_factory=dict)
    sha256: str = ""
    _unit: Unit | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name, rows in (("A", self.A), ("B", self.B), ("C", self.C)):
            require_rows(name, rows)
        self.model()

    def with_files(self, folder: str) -> FMU:
        """Return the same plant with its unit found and checked.

        Raises:
            PlantError: without FMPy, or where the file is no unit that this machine runs.
            ValueError: a variable that it has not.
        """
        path = Path(folder, self.file).resolve()
        if find_spec("fmpy") is None:
            raise PlantError("kind 'fmu' needs FMPy, which runs units of FMI 2 and 3: pip install 'hilrig[fmu]'")
        digest = _digest(path)
        if self.sha256 not in ("", digest):
            raise FieldError("sha256", f"{path} has {digest[:16]}..., and not {self.sha256[:16]}...: it is another file")
        found = replace(self, sha256=digest)
        object.__setattr__(found, "_unit", self._found(path))
        try:
            found.start(np.random.default_rng(0))
        except Exception as error:  # whatever a stranger's library does when it is loaded
            raise FieldError("file", f"{path}: cannot be started: {type(error).__name__}: {error}") from error
        return found

    def _found(self, path: Path) -> Unit:
        import fmpy

        try:
            description = fmpy.read_model_description(str(path))
            platforms = fmpy.supported_platforms(str(path))
        except Exception as error:  # FMPy raises what it likes for a file that is none
            raise FieldError("file", f"{path}: is no FMU: {error}") from error
        version = int(description.fmiVersion.partition(".")[0])
        simulation = description.coSimulation
        if version not in (2, 3) or simulation is None:
            raise FieldError("file", f"{path}: FMI {description.fmiVersion}; expected co-simulation of FMI 2 or 3")
        if fmpy.platform not in platforms and fmpy.platform_tuple not in platforms:
            raise FieldError("file", f"{path}: runs on {', '.join(platforms) or 'no machine'}, and not on {fmpy.platform_tuple}")
        real = {v.name: v for v in description.modelVariables if v.type in ("Real", "Float64") and not v.dimensions}
        named = {
            "commanded": self.commanded or tuple(name for name, v in real.items() if v.causality == "input"),
            "measured": self.measured or tuple(name for name, v in real.items() if v.causality == "output"),
        }
        named["logged"] = self.logged or named["measured"]
        for which, names in (*named.items(), ("parameters", tuple(self.parameters))):
            for name in names:
                if name not in real:
                    raise FieldError(which, f"{path} has no real variable {name!r}; it has {', '.join(list(real)[:20])}")
        model = self.model()
        for which, size in (("commanded", model.B.shape[1]), ("measured", model.C.shape[0])):
            if len(named[which]) != size:
                raise FieldError(which, f"{len(named[which])} variables ({', '.join(named[which])}), but the model has {size}")
        return Unit(
            path=str(path),
            version=version,
            identifier=simulation.modelIdentifier,
            token=description.guid if version == 2 else description.instantiationToken,
            references=tuple(tuple(real[name].valueReference for name in names) for names in named.values()),
            parameters=(tuple(real[name].valueReference for name in self.parameters), tuple(self.parameters.values())),
            signals=tuple(tuple(_signal(name, _unit_of(real[name])) for name in names) for names in named.values()),
        )

    @property
    def unit(self) -> Unit:
        """What was found in the file.

        Raises:
            PlantError: nobody looked for it yet.
        """
        if self._unit is None:
            raise PlantError(f"{self.file}: not read yet; with_files(folder) does")
        return self._unit

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """What is commanded."""
        return self.unit.signals[0]

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """What is measured."""
        return self.unit.signals[1]

    @property
    def states(self) -> tuple[Signal, ...]:
        """What the log keeps as the state."""
        return self.unit.signals[2]

    def model(self) -> StateSpace:
        """Return the linear model that a controller is told."""
        return StateSpace(A=self.A, B=self.B, C=self.C)

    def beyond_model(self) -> tuple[str, ...]:
        """Return that the unit is not its model."""
        return ("an FMU whose equations nobody sees",)

    def start(self, rng: np.random.Generator) -> FMURun:
        """Return the unit at time 0. It draws nothing from ``rng``."""
        return FMURun(self.unit, _unpacked(self.unit.path, self.sha256))


class FMURun:
    """A unit that runs.

    Args:
        unit: what was found in its file.
        folder: where it is unpacked.
    """

    __slots__ = ("__weakref__", "_applied", "_get", "_set", "_slave", "_t_ns", "_unit")

    def __init__(self, unit: Unit, folder: str) -> None:
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        made: Any = FMU2Slave if unit.version == 2 else FMU3Slave
        slave = made(guid=unit.token, unzipDirectory=folder, modelIdentifier=unit.identifier, instanceName="plant")
        slave.instantiate()
        weakref.finalize(self, slave.freeInstance)
        self._slave, self._unit, self._t_ns = slave, unit, 0
        self._set, self._get = (slave.setReal, slave.getReal) if unit.version == 2 else (slave.setFloat64, slave.getFloat64)
        if unit.version == 2:
            slave.setupExperiment(startTime=0.0)
        references, values = unit.parameters
        if references:
            self._set(list(references), list(values))
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        self._applied = (0.0,) * len(unit.references[0])

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        """Hold the input u + w for dt_ns.

        Args:
            dt_ns: time in nanoseconds, at least 0.
            u: commanded input, m entries.
            w: disturbance at the input, m entries, or nothing.

        Raises:
            PlantError: the unit ended the simulation.
        """
        self._applied = tuple(map(float, u))
        if not dt_ns:
            return
        self._set(list(self._unit.references[0]), [a + b for a, b in zip(u, w)] if w else list(u))
        ended = self._slave.doStep(self._t_ns / NS_PER_S, dt_ns / NS_PER_S)
        self._t_ns += dt_ns
        if isinstance(ended, tuple) and ended[1]:
            raise PlantError(f"{self._unit.path}: the unit ended the simulation at {self._t_ns / NS_PER_S:g} s")

    def measure(self) -> tuple[float, ...]:
        """Return what is measured."""
        return tuple(map(float, self._get(list(self._unit.references[1]))))

    @property
    def state(self) -> tuple[float, ...]:
        """What is logged."""
        return tuple(map(float, self._get(list(self._unit.references[2]))))

    @property
    def applied(self) -> tuple[float, ...]:
        """What was commanded in the last advance, without the disturbance."""
        return self._applied


def _digest(path: Path) -> str:
    """Return the SHA-256 of a unit whose contents are of a bounded size."""
    try:
        if not path.is_file() or path.stat().st_size > MOST_BYTES:
            raise FieldError("file", f"{path}: is no file, or has more than {MOST_BYTES} bytes")
        with zipfile.ZipFile(path) as file:
            members = file.infolist()
        if len(members) > MOST_FILES or sum(member.file_size for member in members) > MOST_BYTES:
            raise FieldError("file", f"{path}: unpacks to more than {MOST_FILES} files or {MOST_BYTES} bytes")
        return sha256(path.read_bytes()).hexdigest()
    except (OSError, zipfile.BadZipFile) as error:
        raise FieldError("file", f"{path}: is no FMU: {error}") from error


@cache
def _unpacking(path: str, digest: str) -> tempfile.TemporaryDirectory[str]:
    import fmpy

    folder = tempfile.TemporaryDirectory(prefix="hilrig-fmu-")  # removed when the process ends
    fmpy.extract(path, folder.name)
    return folder


def _unpacked(path: str, digest: str) -> str:
    """Return where a unit is unpacked, once for each process and file."""
    return _unpacking(path, digest).name


def _signal(name: str, unit: str) -> Signal:
    return Signal(_NO_LETTER.sub("_", name.lower()).strip("_") or "x", unit)


def _unit_of(variable: Any) -> str:
    declared = variable.declaredType
    return str(variable.unit or (declared.unit if declared is not None else None) or "1")
