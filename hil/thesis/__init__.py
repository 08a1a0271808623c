"""The thesis's numbers beside computed ones: a module a chapter, such as ``chapter7``, that holds its `Chapter`.

A statement is data: what is printed, which computed number, by which rule (``statements``); a row is a statement judged, and no
verdict is written down (``judgement``). A chapter is a list of stages (``chapter``); ``pages`` draws the results, and
says what the rules can tell.
"""

from __future__ import annotations

import importlib
import pkgutil

from design.lmi import check_solvers
from hil.errors import unknown_name
from hil.thesis.chapter import Chapter, Checkpoint, Part, Plot, Progress, Reproduction, Stage, Step, compute
from hil.thesis.judgement import VERDICTS, Check, Row
from hil.thesis.pages import power, power_in_words
from hil.thesis.statements import Statement

__all__ = [
    "VERDICTS", "Chapter", "Check", "Checkpoint", "Part", "Plot", "Progress", "Reproduction", "Row", "Stage", "Statement",
    "Step", "chapters", "compute_chapter", "power", "power_in_words", "reproduce", "seconds_left",
]  # fmt: skip


def chapters() -> tuple[str, ...]:
    """Names of the chapters that can be reproduced, e.g. ``("ch2", "ch3")``."""
    names = (info.name.removeprefix("chapter") for info in pkgutil.iter_modules(__path__))
    return tuple(sorted(f"ch{name}" for name in names if name.isdigit()))


def compute_chapter(chapter: str, progress: Progress = lambda step: None, kept: Checkpoint | None = None) -> Reproduction:
    """Compute a chapter, but for the stages that were kept.

    Raises:
        KeyError: it is not one of ``chapters()``.
        DesignError: the packages of ``hilrig[design]`` are not installed.
    """
    check_solvers()
    return compute(_asked(chapter), progress, chapter, kept)


def reproduce(chapter: str) -> Reproduction:
    """Compute every number of a chapter of the thesis and judge it beside the printed one.

    Args:
        chapter: "ch2" to "ch7"; some take minutes.

    Returns:
        ``rows`` with their verdicts, ``counts`` of them, ``figures``.

    Raises:
        HilError: no such chapter.
    """
    if not isinstance(chapter, str) or chapter not in chapters():
        raise unknown_name("chapter", chapter, chapters())
    return compute_chapter(chapter)


def seconds_left(chapter: str, kept: Checkpoint | None = None) -> float:
    """How long a chapter takes on two quiet cores, nominally, without the stages that were kept; s."""
    return sum(s.seconds for s in _asked(chapter).stages if kept is None or kept.get(chapter, s.title) is None)


def _asked(chapter: str) -> Chapter:
    if chapter not in chapters():
        raise KeyError(chapter)
    asked: Chapter = importlib.import_module(f"hil.thesis.chapter{chapter.removeprefix('ch')}").CHAPTER
    return asked
