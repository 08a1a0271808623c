"""Inputs with the right form and the wrong contents, drawn by hypothesis."""

from __future__ import annotations

import json
from typing import Any

from hypothesis import strategies as st

leaf = st.one_of(
    st.none(), st.booleans(), st.integers(), st.integers(-(10**400), 10**400), st.floats(), st.text(max_size=20),
    st.sampled_from(["nan s", "1e400 s", "\x1b[2J", "[/]", "inf", "-0.0"]),
)  # fmt: skip
value = st.recursive(
    leaf, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3), max_leaves=5
)


@st.composite
def damaged(draw: st.DrawFn, tree: Any) -> Any:
    """A JSON tree with one to three of its nodes replaced or removed."""
    tree = json.loads(json.dumps(tree))
    for _ in range(draw(st.integers(1, 3))):
        node = tree
        while isinstance(node, dict | list) and node:
            key = draw(st.sampled_from(sorted(node) if isinstance(node, dict) else range(min(len(node), 4))))
            if not isinstance(node[key], dict | list) or not node[key] or draw(st.integers(0, 3)) == 0:
                if isinstance(node, dict) and draw(st.booleans()):
                    del node[key]
                else:
                    node[key] = draw(value)
                break
            node = node[key]
    return tree


@st.composite
def edited(draw: st.DrawFn, text: str) -> str:
    """A text with a few pieces cut, doubled or replaced."""
    pieces = [*"=[]{}\"'\n.#\\", "9" * 4400, "1e400", "nan", '"""', "\x1b[2J", "a." * 40, "[" * 40, "inf", "-1", "\0", "é"]
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(text)))
        text = text[:at] + draw(st.sampled_from(pieces)) + text[at + draw(st.integers(0, 12)) :]
    return text
