"""Text of strangers on a terminal: what would move the cursor or colour a line is shown as what it is, and is not obeyed."""

from __future__ import annotations

import unicodedata
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rich.text import Text

LONGEST: Final = 2000
"""Bytes of a message, all of its lines together."""

_UNSEEN: Final = ("Cc", "Cf", "Cs", "Co", "Zl", "Zp")  # control, direction and other invisible, half characters, line ends


def visible(text: object) -> str:
    r"""Return a text with its control characters escaped.

    Args:
        text: anything; its `str` is taken.

    >>> visible("a\x1b[2Jb")
    'a\\x1b[2Jb'
    """
    found = str(text)
    if found.isprintable():
        return found
    return "".join(c.encode("unicode_escape").decode() if unicodedata.category(c) in _UNSEEN else c for c in found)


def message_lines(text: str) -> list[str]:
    """Return the lines of a message, escaped, in at most `LONGEST` bytes; what was left out is counted.

    Args:
        text: one fault a line.
    """
    lines = text.split("\n")
    kept: list[str] = []
    left = LONGEST - 40
    for line in lines:
        shown = visible(line)
        size = len(shown.encode()) + 6  # "hil: " and the line's end
        if size > left:
            if not kept:
                kept.append(shown.encode()[: max(left - 10, 0)].decode(errors="ignore") + " ...")
            break
        kept.append(shown)
        left -= size
    if len(kept) < len(lines):
        kept.append(f"... and {len(lines) - len(kept)} more of these")
    return kept


def cell(value: object, style: str = "") -> Text:
    """Return a table's cell that shows a text as it is: escaped, and without markup.

    Args:
        value: anything; its `str` is taken.
        style: of rich.
    """
    from rich.text import Text

    return Text(visible(value), style=style)
