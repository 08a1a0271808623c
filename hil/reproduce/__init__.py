"""The thesis's numbers beside computed ones: one room per chapter, each with a module ``numbers`` that holds its `Chapter`.

A row says what is printed, what comes out, and by which rule the one is judged against the other (``judgement``): no verdict is
written down. A chapter is a list of stages (``chapter``); ``pages`` draws the results.
"""

from __future__ import annotations

import importlib
import pkgutil

from hil.reproduce.chapter import Chapter, Part, Plot, Progress, Reproduction, Stage, Step, Tell, compute
from hil.reproduce.judgement import VERDICTS, Check, Row, Verdict

__all__ = [
    "VERDICTS", "Chapter", "Check", "Part", "Plot", "Progress", "Reproduction", "Row", "Stage", "Step", "Tell", "Verdict",
    "chapters", "reproduce",
]  # fmt: skip


def chapters() -> tuple[str, ...]:
    """Names of the chapters that can be reproduced, e.g. ``("ch2", "ch3")``."""
    rooms = (info.name for info in pkgutil.iter_modules(__path__) if info.ispkg)
    return tuple(sorted(f"ch{room.removeprefix('chapter')}" for room in rooms if room.startswith("chapter")))


def reproduce(chapter: str, progress: Progress = lambda step: None) -> Reproduction:
    """Compute a chapter. Raises KeyError if it is not one of ``chapters()``."""
    if chapter not in chapters():
        raise KeyError(chapter)
    room = importlib.import_module(f"hil.reproduce.chapter{chapter.removeprefix('ch')}.numbers")
    asked: Chapter = room.CHAPTER
    return compute(asked, progress)
