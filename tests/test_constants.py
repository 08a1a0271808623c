"""A name of a module means one thing: what is given a second value there has lost the first one for all functions."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

from tests.mutations.reach import ROOT, product_files


def set_twice(file: str) -> list[str]:
    body = ast.parse(Path(ROOT, file).read_text()).body
    targets = (target for each in body if isinstance(each, ast.Assign) for target in each.targets)
    names = (node for target in targets for node in ast.walk(target) if isinstance(node, ast.Name))
    times = Counter(node.id for node in names if isinstance(node.ctx, ast.Store))
    return [f"{file}: {name}" for name, number in times.items() if number > 1]


def test_no_constant_of_a_module_is_set_twice() -> None:
    assert [each for file in product_files() for each in set_twice(file)] == []
