"""A plant in a functional mock-up unit: FMI 2 or 3 for co-simulation, run by FMPy (``pip install 'hilrig[fmu]'``)."""

from __future__ import annotations

import re
import zipfile
from dataclasses import dataclass, field, replace
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np

from plants.errors import FieldError, PlantError, require_rows
from plants.fmu_run import FMURun
from plants.parts import Signal, StateSpace
from plants.parts.exponential import Rows

MOST_BYTES: Final = 500_000_000
LEAST_BYTES: Final = 1 << 24
MOST_RATIO: Final = 40
"""A unit unpacks to so many times its own length at most, or to 16 MiB: libraries shrink to a third or a tenth."""

MOST_FILES: Final = 2_000
MOST_VARIABLES: Final = 50_000
MOST_DESCRIPTION: Final = 20_000_000
_DESCRIPTION: Final = "modelDescription.xml"
_IDENTIFIER: Final = re.compile(r"[A-Za-z_][\w.-]*", re.ASCII)
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
    """A plant that a functional mock-up unit computes, by co-simulation: native code of the file runs in a process of its own.

    The rig steps it from slot to slot under a held input. Whether two steps are one of their sum is the unit's own affair; A, B
    and C are what a controller is given of it, and no claim on them is a claim on the unit.

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
        except PlantError as error:
            raise FieldError("file", f"{path}: cannot be started: {str(error).removeprefix(f'{path}: ')}") from error
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
        if not _IDENTIFIER.fullmatch(simulation.modelIdentifier or ""):
            raise FieldError("file", f"{path}: modelIdentifier {simulation.modelIdentifier!r:.60} is no name of a library")
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
            PlantError: it was not looked for yet.
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
        """Return the linear model that a controller knows."""
        return StateSpace(A=self.A, B=self.B, C=self.C)

    def beyond_model(self) -> tuple[str, ...]:
        """Return that the unit is not its model."""
        return ("an FMU, whose equations are not known",)

    def start(self, rng: np.random.Generator) -> FMURun:
        """Return the unit at time 0. It draws nothing from ``rng``."""
        return FMURun(self.unit, self.sha256)


def _digest(path: Path) -> str:
    """Return the SHA-256 of a unit whose contents are of a bounded size, and whose description is read in seconds."""
    try:
        if not path.is_file() or path.stat().st_size > MOST_BYTES:
            raise FieldError("file", f"{path}: is no file, or has more than {MOST_BYTES} bytes")
        with zipfile.ZipFile(path) as file:
            members = file.infolist()
            unpacked, most = sum(member.file_size for member in members), most_unpacked(path.stat().st_size)
            if len(members) > MOST_FILES or unpacked > most:
                message = f"unpacks to {len(members)} files, {unpacked} bytes; at most {MOST_FILES} and {most}"
                raise FieldError("file", f"{path}: {message}")
            with file.open(_DESCRIPTION) as member:
                text = member.read(MOST_DESCRIPTION + 1)
        variables = text.count(b"valueReference")
        if len(text) > MOST_DESCRIPTION or variables > MOST_VARIABLES:
            size = f"{variables} variables" if len(text) <= MOST_DESCRIPTION else f"more than {MOST_DESCRIPTION} bytes"
            raise FieldError("file", f"{path}: its {_DESCRIPTION} has {size}; at most {MOST_VARIABLES} variables are taken")
        return sha256(path.read_bytes()).hexdigest()
    except FieldError:
        raise
    except Exception as error:  # zipfile raises what it likes for an archive that is none, lzma.LZMAError and EOFError too
        raise FieldError("file", f"{path}: is no FMU: {type(error).__name__}: {error}") from error


def most_unpacked(length: int) -> int:
    """Return how many bytes a unit of so many may unpack to.

    >>> most_unpacked(1000), most_unpacked(10**6), most_unpacked(10**9)
    (16777216, 40000000, 500000000)
    """
    return min(MOST_BYTES, max(LEAST_BYTES, MOST_RATIO * length))


def _signal(name: str, unit: str) -> Signal:
    return Signal(_NO_LETTER.sub("_", name.lower()).strip("_") or "x", unit)


def _unit_of(variable: Any) -> str:
    declared = variable.declaredType
    return str(variable.unit or (declared.unit if declared is not None else None) or "1")
