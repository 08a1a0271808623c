"""A name of a module means one thing: what is given a second value there has lost the first one for all functions."""

from __future__ import annotations

import ast
import re
from collections import Counter
from pathlib import Path

from tests.mutations.reach import ROOT, product_files

SET = re.compile(r"^(\w[\w, =]*) =", re.M)
"""What looks as if it set names: no tree is made of a file in which no name is there twice."""


def set_twice(file: str) -> list[str]:
    text = Path(ROOT, file).read_text()
    words = re.findall(r"\w+", " ".join(SET.findall(text)))
    body = ast.parse(text).body if len(words) > len({*words}) else []
    targets = (target for each in body if isinstance(each, ast.Assign) for target in each.targets)
    names = (node for target in targets for node in ast.walk(target) if isinstance(node, ast.Name))
    times = Counter(node.id for node in names if isinstance(node.ctx, ast.Store))
    return [f"{file}: {name}" for name, number in times.items() if number > 1]


def test_no_constant_of_a_module_is_set_twice() -> None:
    assert [each for file in product_files() for each in set_twice(file)] == []


def test_one_that_is_set_twice_is_found(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("A = B = 1\nC, B = 2, 3\n")
    assert set_twice(str(tmp_path / "a.py")) == [f"{tmp_path}/a.py: B"]
