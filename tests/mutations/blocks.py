"""The blocks of a file's functions, by name, and the file with a probe at the head of each.

A block is a list of statements that run one after the other: a function's body, a branch, a loop's body. Its name is that of its
function and its number in it, so that lines may move elsewhere in the file.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator

Statements = list[ast.stmt]


def nodes(tree: ast.Module) -> Iterator[tuple[ast.AST, str]]:
    """Yield each node with the name of the block that it stands in; outside of functions the name is empty."""
    return ((node, block) for node, block, statements in _walk(tree, "", "", {}) if statements is None)


def blocks(tree: ast.Module) -> Iterator[tuple[str, Statements]]:
    """Yield each block of a function with its name."""
    return ((block, statements) for _, block, statements in _walk(tree, "", "", {}) if statements is not None)


def _walk(node: ast.AST, path: str, block: str, count: dict[str, int]) -> Iterator[tuple[ast.AST, str, Statements | None]]:
    yield node, block, None
    function, kind = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef), isinstance(node, ast.ClassDef)
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        path = f"{path}.{node.name}".lstrip(".")
    for _, value in ast.iter_fields(node):
        children = [child for child in (value if isinstance(value, list) else [value]) if isinstance(child, ast.AST)]
        here = block
        if isinstance(value, list) and children and isinstance(children[0], ast.stmt) and (function or (block and not kind)):
            count[path] = count.get(path, -1) + 1
            here = f"{path}#{count[path]}"
            yield node, here, value
        for child in children:
            yield from _walk(child, path, here, count)


def with_probes(text: str, number: Callable[[str], int]) -> str:
    """Return a file's text, each block of which calls the probe when it is reached.

    Args:
        text: the file.
        number: of a block's name, the number that the probe writes.
    """
    tree = ast.parse(text)
    for block, statements in list(blocks(tree)):
        n = number(block)
        probe = ast.parse(f"{n} in _seen_ or _note_({n})").body[0]
        statements.insert(_behind_docstring(statements), probe)
    head = ast.parse("from tests.mutations.probe import note as _note_, seen as _seen_").body
    future = sum(isinstance(s, ast.ImportFrom) and s.module == "__future__" for s in tree.body)
    start = _behind_docstring(tree.body) + future
    tree.body[start:start] = head
    return ast.unparse(ast.fix_missing_locations(tree))


def _behind_docstring(body: Statements) -> int:
    first = body[0] if body else None
    return int(isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str))
