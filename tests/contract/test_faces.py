"""The faces: what a type checker reads of a package is what it brings at run time."""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path

import pytest

TOP = Path(__file__).parents[2]


@pytest.mark.parametrize("package", ["plants", "transport", "design", "design.controllers", "hil"])
def test_names_for_type_checkers_are_those_of_the_package(package: str) -> None:
    face = import_module(package)
    stated: dict[str, str] = {}
    for node in ast.walk(ast.parse((TOP / package.replace(".", "/") / "__init__.py").read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module is not None and node.module.startswith(package):
            stated |= {name.name: node.module for name in node.names if name.asname == name.name}
    stated |= {name: package for name in face.__all__ if name in vars(face) and name not in stated}
    assert sorted(stated) == face.__all__ and set(stated) <= set(dir(face))
    for name, module in stated.items():
        assert getattr(face, name) is getattr(import_module(module), name)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        face.nothing  # noqa: B018
