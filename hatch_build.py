"""Writes the JSON Schema of experiments when the package is built or installed: it is computed, and no file of the repository."""

from __future__ import annotations

import json
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SCHEMA = Path("hil", "experiments", "experiment.schema.json")


class ExperimentSchema(BuildHookInterface):  # type: ignore[misc]
    """Calls `hil.experiment.schema` with the plug-ins that pyproject.toml names, as nothing is installed yet."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        root = Path(self.root)
        sys.path.insert(0, str(root))
        try:
            from hil.experiment.schema import experiment_schema

            plugins = {}
            for group in ("hil.plants", "hil.controllers", "hil.laws"):
                named = self.metadata.core.entry_points[group].items()
                plugins[group] = {name: _class(place) for name, place in sorted(named)}
            text = json.dumps(experiment_schema(plugins), indent=2) + "\n"
        finally:
            sys.path.remove(str(root))
        (root / SCHEMA).write_text(text)
        build_data["artifacts"].append(f"/{SCHEMA.as_posix()}")


def _class(place: str) -> type:
    module, _, name = place.partition(":")
    found: type = getattr(import_module(module), name)  # a face brings its names when they are asked for
    return found
