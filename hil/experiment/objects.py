"""Experiments of objects: a plant or a controller that was built in Python takes the place of its table."""

from __future__ import annotations

import dataclasses
from typing import Any

import msgspec

from hil.errors import ExperimentError
from hil.experiment.tables import Experiment
from hil.plugins import registry
from hil.plugins.protocols import ReferencesFiles
from hil.plugins.user_plugins import own_fault
from plants.errors import PlantError


def with_objects(experiment: Experiment, **objects: object) -> Experiment:
    """Return the same experiment with a plant, a controller, or both, of Python.

    An object whose class is an installed plug-in is what its table would make, and the log says its kind; any other has the kind
    ``object my_module.Cart``, and a log of it needs the object to run again.

    Args:
        experiment: the rest.
        objects: `plant` and `controller`.

    Raises:
        ExperimentError: an object that is no plant or no controller, with what it lacks.
    """
    faults, changes, kinds = [], dict[str, Any](), dict(experiment.kinds)
    for path, made in objects.items():
        group, cls = registry.group_of(path), type(made)
        installed = registry.kind_of_class(group, cls) if dataclasses.is_dataclass(cls) else None
        fault = own_fault(group, made) if installed is None else None
        if isinstance(made, ReferencesFiles):
            try:
                made = made.with_files(experiment.folder)
            except (ValueError, PlantError) as error:
                fault = str(error)
        if fault is not None:
            faults.append(f"{path}: {cls.__module__}.{cls.__qualname__}: {fault}")
        changes[path], kinds[path] = made, installed or registry.object_kind(cls)
    if faults:
        raise ExperimentError(experiment.name, faults)
    return msgspec.structs.replace(experiment, kinds=kinds, **changes) if objects else experiment
