"""Gains that a solver wrote into a file beside their experiment: what runs is the same on every machine.

The last digits of what is solved depend on the machine, by its BLAS and its ``libm``. So the gains of an experiment that asks for
a design stand in ``gains/NAME.json`` beside it, with the digest of the problem that they solve. Only gains are taken from there:
their certificate is computed from them, as of any others. ``hil solve`` writes the file.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec
import numpy as np

from design.controllers import Controller
from design.errors import FieldError
from design.verdict import digest
from hil.errors import ExperimentError, HilError
from hil.experiment import Experiment, parse_table
from hil.experiment.table import plain
from hil.files import read_regular
from hil.plugins import is_own, written_in
from hil.plugins.user_plugins import Designer, GainsOnFile, GivesGains, NamedController
from hil.rig.loop import Gains

if TYPE_CHECKING:
    from design.requests.tracking import DesignTask

FORMAT: Final = "hilrig-gains/1"
LARGEST: Final = 16_000_000
"""Bytes of a file."""


class NoDigest(ValueError):
    """A part of the problem has no digest, such as a function."""


def gains_file(experiment: Experiment) -> Path:
    """Return where the gains of an experiment stand."""
    return Path(experiment.folder) / "gains" / f"{experiment.name}.json"


def solve(request: Designer, task: DesignTask) -> NamedController:
    """Return the controller that a designer, of the user's own perhaps, solves to.

    Raises:
        FieldError: it returned something else.
        ValueError, DesignError: as `Designer.solve`.
    """
    made = request.solve(task)
    if isinstance(made, NamedController):
        return made
    expected = "the controller that runs: `kind` (\"module:Class\" or a plug-in's name), `start(model)`"
    name, returned = type(request).__qualname__, type(made).__qualname__
    raise FieldError("kind", f"{name}: solve(task) returned a {returned}, expected {expected}")


def solve_controller(experiment: Experiment, task: DesignTask) -> tuple[NamedController, Gains | None]:
    """Return the controller that an experiment asks for, stored or solved, and where its gains come from.

    Args:
        experiment: its controller is a `Designer`.
        task: the loop.

    Returns:
        the controller, and None where the experiment itself gives the gains.

    Raises:
        ValueError, DesignError: as `Designer.solve`.
    """
    asked: Any = experiment.controller
    if isinstance(asked, GivesGains) and asked.gains_given:
        return solve(asked, task), None
    path = gains_file(experiment)
    try:
        own = problem_digest(asked, task)
    except NoDigest as error:
        return solve(asked, task), Gains(origin="solved here", note=f"{error}, so that no file can hold them")
    stored, why = _stored(path, own, experiment.folder, runs_own=written_in(type(asked)) is not None)
    if stored is not None:
        return stored, Gains(origin="stored")
    note = f"{path.parent.name}/{path.name} {why}; `hil solve` stores them, for the same bits on every machine"
    return solve(asked, task), Gains(origin="solved here", note=note)


def fitted(request: GainsOnFile, controller: NamedController, task: DesignTask) -> tuple[NamedController, Gains]:
    """Return the gains of a user's file, or others where the file's problem is not that of the loop; and where they come from.

    Args:
        request: names the file.
        controller: what stands there.
        task: the loop; its chains have the labels that these gains tell apart.

    Raises:
        ValueError, DesignError: as `Designer.solve`.
    """
    why = request.unfit(task)
    if not why:
        return controller, Gains(origin="stored")
    note = f"{request.file} is of another problem ({why}); `hil design -o` writes one of this; kind = \"send-all\" runs any gains"
    return request.solve_again(task), Gains(origin="solved here", note=note)


def problem_digest(request: Designer, task: DesignTask) -> str:
    """Return the SHA-256 of what decides the gains: the request and the loop, number by number."""
    return digest({"request": _said(request), "task": _said(dataclasses.replace(task, folder="", chainless=""))})


def gains_text(experiment: Experiment, controller: NamedController, own: str) -> str:
    """Return the text of a file of gains.

    Args:
        experiment: whose they are.
        controller: what was solved.
        own: digest of the problem.
    """
    said = {"format": FORMAT, "experiment": experiment.name, "problem": own, "kind": controller.kind}
    return json.dumps({**said, "controller": plain(controller)}, indent=1) + "\n"


def _stored(path: Path, own: str, folder: str, *, runs_own: bool) -> tuple[NamedController | None, str]:
    """Return the controller of a file, or None and why not; `runs_own`: the experiment itself names a module beside it."""
    if not path.exists():
        return None, "is not there"
    try:
        said = json.loads(read_regular(path, LARGEST, "a file of gains"))
        if not isinstance(said, dict) or said.get("format") != FORMAT or not isinstance(said.get("controller"), dict):
            return None, f"is no file of gains ({FORMAT})"
        if is_own(str(said.get("kind"))) and not runs_own:
            return None, f"names a module, {said['kind']!r:.40}, which the experiment does not: it is not run"
        if said.get("problem") != own:
            return None, "is of another problem"
        made = parse_table("hil.controllers", {**said["controller"], "kind": said.get("kind")}, "controller", folder)
    except (HilError, ExperimentError, ValueError, RecursionError) as error:
        return None, f"cannot be used: {str(error).splitlines()[0]:.200}"
    if not isinstance(made, Controller):
        return None, "holds no controller that runs"
    return made, ""  # type: ignore[return-value]  # made by its kind's table


def _said(value: Any) -> Any:
    """Return a value as `digest` takes it; what is no number, text, table or list has no digest."""
    names: Iterable[str] | None = None
    if isinstance(value, msgspec.Struct):
        names = value.__struct_fields__
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = (f.name for f in dataclasses.fields(value) if f.init)
    if names is not None:
        fields = {name: _said(getattr(value, name)) for name in names}
        stated = {name: said for name, said in fields.items() if said not in (None, "", [], {})}  # what is left out says nothing
        return {"class": type(value).__qualname__, **stated}
    if isinstance(value, np.ndarray | np.generic):
        return _said(value.tolist())
    if isinstance(value, Mapping):
        return {str(k): _said(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_said(v) for v in value]
    if value is None or isinstance(value, str | int | float):
        return value
    raise NoDigest(f"the problem holds a {type(value).__name__}")
