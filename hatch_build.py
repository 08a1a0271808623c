"""What the build adds to the packages: the JSON Schema of experiments, and the compiled loop where it is asked for."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping, Sequence
from contextlib import chdir
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SCHEMA = Path("hil", "experiments", "experiment.schema.json")

COMPILE = "HILRIG_COMPILE"
"""Set to 1, the wheel holds the modules of the loop compiled by mypyc too."""

COMPILERS = ("mypy", "setuptools")
"""What compiles, in the versions of constraints.txt; and the machine's C compiler."""


class Additions(BuildHookInterface[Any]):
    """Writes the schema, and compiles what the hook's table in pyproject.toml names: for a wheel, never for a checkout."""

    def dependencies(self) -> list[str]:
        return pinned(Path(self.root, "constraints.txt")) if os.environ.get(COMPILE) == "1" else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        root = Path(self.root)
        write_schema(root, self.metadata.core.entry_points)
        build_data["artifacts"].append(f"/{SCHEMA.as_posix()}")
        if self.target_name == "wheel" and version == "standard" and os.environ.get(COMPILE) == "1":
            self._folder = TemporaryDirectory(prefix="hilrig-compiled-")
            build_data["force_include"] |= compiled(root, self.config["compiled"], Path(self._folder.name))
            build_data["pure_python"], build_data["infer_tag"] = False, True

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        if not build_data.get("pure_python", True):
            self._folder.cleanup()


def write_schema(root: Path, entry_points: Mapping[str, Mapping[str, str]]) -> None:
    """Write what `hil.experiment.schema` says of the plug-ins that pyproject.toml names, as nothing is installed yet."""
    sys.path.insert(0, str(root))
    try:
        from hil.experiment.schema import experiment_schema

        plugins = {}
        for group in ("hil.plants", "hil.controllers", "hil.laws"):
            plugins[group] = {name: _class(place) for name, place in sorted(entry_points[group].items())}
        text = json.dumps(experiment_schema(plugins), indent=2) + "\n"
    finally:
        sys.path.remove(str(root))
    (root / SCHEMA).write_text(text)


def _class(place: str) -> type:
    module, _, name = place.partition(":")
    found: type = getattr(import_module(module), name)  # a face brings its names when they are asked for
    return found


def pinned(constraints: Path) -> list[str]:
    """Return what compiles, with its versions."""
    lines = [line.split()[0] for line in constraints.read_text().splitlines() if "==" in line]
    return [line for line in lines if line.partition("==")[0] in COMPILERS]


def compiled(root: Path, modules: Sequence[str], folder: Path) -> dict[str, str]:
    """Compile modules, from the same files that run interpreted; return where in the wheel each library belongs.

    Args:
        root: of the sources.
        modules: paths from there.
        folder: empty; the libraries are left in it.

    Raises:
        SystemExit: mypy refuses a module.
        CompileError: there is no C compiler, or it refuses a file.
    """
    from mypyc.build import mypycify
    from setuptools import Distribution
    from setuptools.command.build_ext import build_ext

    flags = ["--config-file=", f"--cache-dir={folder / 'types'}", "--follow-imports=silent", "--ignore-missing-imports"]
    with chdir(root):
        own = mypycify([*flags, *modules], opt_level="2", debug_level="0", group_name="hilrig", target_dir=str(folder / "c"))
        for each in own:  # a product and a sum are rounded twice, as the interpreter rounds them, on ARM too
            each.extra_compile_args.append("-ffp-contract=off")
        build = build_ext(Distribution({"name": "hilrig", "ext_modules": own}))
        build.build_lib, build.build_temp = str(folder / "lib"), str(folder / "o")
        build.ensure_finalized()
        build.run()
    found = sorted((folder / "lib").rglob("*.so"))
    return {str(path): path.relative_to(folder / "lib").as_posix() for path in found}
