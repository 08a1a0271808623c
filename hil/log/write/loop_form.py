"""In which form the loop runs: its modules compiled by mypyc, or the same files interpreted."""

from __future__ import annotations

from typing import Literal

from hil.log.write import frame_length

LoopForm = Literal["compiled", "interpreted"]


def loop_form() -> LoopForm:
    """Return it: the modules that pyproject.toml names are compiled together or not at all, and this asks one of them."""
    return "interpreted" if str(frame_length.__file__).endswith(".py") else "compiled"
