"""The thesis's numbers beside computed ones: a module a chapter, such as ``chapter7``, that holds its `Chapter`.

A statement is data: what is printed, which computed number, by which rule (``statements``); a row is a statement judged, and no
verdict is written down (``judgement``). ``pages`` draws the results, and says what the rules can tell.

A chapter is a list of stages, ``CHAPTER = Chapter(title=..., stages=(Stage(...), ...))``. A stage computes numbers by name and
says how far it is; its `Statement` s are judged by them. It gives rows and figures, and shares nothing with others but the code
that they call: what was done could be kept.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from design.errors import check_solvers
from hil.errors import HilError, unknown_name
from hil.notebook import Result, data_frame
from hil.pages import Bars, Figure, Histogram
from hil.pages.paper import draw
from hil.thesis.judgement import VERDICTS, Row
from hil.thesis.statements import Statement, judge

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure as Sheet

    from hil.thesis.checkpoint import KeptStages


Array = NDArray[np.float64]
SHOWN: Final = ("item", "printed", "computed", "rule", "verdict")
"""What a table shows of a row."""


class Plot(Struct, frozen=True, kw_only=True):
    """One figure of a chapter: its number there, and the panels that show it."""

    title: str
    panels: tuple[Figure | Bars | Histogram, ...]
    intro: str = ""


class Part(Struct, frozen=True, kw_only=True):
    """What a stage found."""

    rows: tuple[Row, ...] = ()
    figures: tuple[Plot, ...] = ()


class ReportProgress(Protocol):
    """A stage reports its progress: in words, and, where it counts its steps, as ``done`` of ``total``."""

    def __call__(self, text: str, done: int = 0, total: int = 0, /) -> None:
        """Report it; costs nothing."""


class Stage(Struct, frozen=True):
    """A piece of a chapter that stands alone.

    Args:
        title: what it computes, in a few words.
        compute: takes a `ReportProgress`, returns numbers by name; under ``figures`` those that it draws.
        seconds: how long it takes on two quiet cores, by which the remaining time is estimated; no promise.
        statements: what is judged by the numbers.
    """

    title: str
    compute: Callable[[ReportProgress], Mapping[str, Any]]
    seconds: float = 1.0
    statements: Sequence[Statement] = ()

    def part(self, report_progress: ReportProgress) -> Part:
        """Compute the numbers and judge the statements by them."""
        values = self.compute(report_progress)
        return Part(rows=judge(self.statements, values), figures=tuple(values.get("figures", ())))


class Chapter(Struct, frozen=True, kw_only=True):
    """A chapter before it is computed."""

    title: str
    stages: tuple[Stage, ...]


class Step(Struct, frozen=True, kw_only=True):
    """How far a reproduction is.

    Args:
        stage: title of the stage that runs.
        number: its number, from 1.
        stages: how many there are.
        text: what the stage said last, empty when it begins.
        done: steps of the stage that are done.
        total: steps of the stage; 0 where they are not counted.
        seconds: nominal length of what has been computed of the chapter, s; what was kept from before does not count.
    """

    stage: str
    number: int
    stages: int
    text: str = ""
    done: int = 0
    total: int = 0
    seconds: float = 0.0


Progress = Callable[[Step], None]


class Reproduction(Struct, frozen=True, kw_only=True):
    """Everything of one chapter."""

    title: str
    rows: tuple[Row, ...]
    figures: tuple[Plot, ...] = ()

    @property
    def counts(self) -> dict[str, int]:
        """How many rows have which verdict."""
        return {verdict: sum(row.verdict == verdict for row in self.rows) for verdict in VERDICTS}

    def to_json(self) -> dict[str, object]:
        """Title, rows and a count per verdict, as a dictionary that ``json.dumps`` takes."""
        return {"title": self.title, "rows": [row.to_json() for row in self.rows], "counts": self.counts}

    def to_pandas(self) -> pandas.DataFrame:
        """Return a row per statement: what it is of, what is printed, what is computed, its rule and its verdict.

        Raises:
            HilError: if pandas is not installed.
        """
        return data_frame({name: [str(getattr(row, name)) for row in self.rows] for name in SHOWN})

    def plot(
        self, path: str | Path | None = None, *, figure: str | None = None, width_mm: float = 85.0, height_mm: float = 70.0
    ) -> Sheet:
        """Draw a figure of the chapter, its panels one above the other; write it to a file where one is named.

        Args:
            path: ends in .svg, .pdf or .png.
            figure: its title or the begin of it, as in ``figures``; the first by default.
            width_mm, height_mm: of each panel as it is printed.

        Raises:
            HilError: the chapter has no such figure, or it cannot be drawn or written.
        """
        if not self.figures:
            raise HilError(f"plot: {self.title} has no figures")
        titles = [each.title for each in self.figures]
        chosen = next((each for each in self.figures if each.title.startswith(figure or "")), None)
        if chosen is None:
            raise unknown_name("figure", figure, titles)
        return Result(line="", paint=partial(_paint, chosen)).plot(path, width_mm, height_mm * len(chosen.panels))

    def _repr_html_(self) -> str:
        rows = [[str(getattr(row, name)) for name in SHOWN] for row in self.rows]
        return Result(
            line=repr(self)[1:-1], columns=SHOWN, rows=rows, paint=partial(_paint, self.figures[0]) if self.figures else None
        ).html()

    def __repr__(self) -> str:
        counts = ", ".join(f"{count} {verdict}" for verdict, count in self.counts.items())
        return f"<Reproduction of {self.title}: {len(self.rows)} rows, {counts}>"


def _paint(plot: Plot, sheet: Sheet) -> None:
    axes = sheet.subplots(len(plot.panels), 1, squeeze=False)[:, 0]
    for axis, panel in zip(axes, plot.panels, strict=True):
        draw(panel, axis)
        axis.set_title(panel.title, fontsize="small")


def compute(chapter: Chapter, progress: Progress, name: str = "", kept: KeptStages | None = None) -> Reproduction:
    """Run every stage in order, but those that were kept.

    Args:
        chapter: what to compute.
        progress: called with how far it is.
        name: of the chapter, under which its stages are kept.
        kept: what was done before, and where the rest is put as it is done.
    """
    parts = {s.title: kept.get(name, s.title) if kept else None for s in chapter.stages}
    seconds = 0.0
    for number, stage in enumerate(chapter.stages, start=1):
        if parts[stage.title] is not None:
            continue

        def report_progress(
            text: str, done: int = 0, total: int = 0, /, number: int = number, stage: Stage = stage, seconds: float = seconds
        ) -> None:  # fmt: skip
            part = stage.seconds * min(done / total, 1.0) if total else 0.0
            progress(
                Step(
                    stage=stage.title, number=number, stages=len(chapter.stages), text=text, done=done, total=total,
                    seconds=seconds + part,
                )
            )  # fmt: skip

        report_progress("")
        found = parts[stage.title] = stage.part(report_progress)
        if kept:
            kept.put(name, stage.title, found)
        seconds += stage.seconds
    every = [part for part in parts.values() if part is not None]
    rows = tuple(each for part in every for each in part.rows)
    return Reproduction(title=chapter.title, rows=rows, figures=tuple(plot for part in every for plot in part.figures))


def chapters() -> tuple[str, ...]:
    """Names of the chapters that can be reproduced, e.g. ``("ch2", "ch3")``."""
    names = (info.name.removeprefix("chapter") for info in pkgutil.iter_modules(__path__))
    return tuple(sorted(f"ch{name}" for name in names if name.isdigit()))


def compute_chapter(chapter: str, progress: Progress = lambda step: None, kept: KeptStages | None = None) -> Reproduction:
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


def seconds_left(chapter: str, kept: KeptStages | None = None) -> float:
    """How long a chapter takes on two quiet cores, nominally, without the stages that were kept; s."""
    return sum(s.seconds for s in _asked(chapter).stages if kept is None or kept.get(chapter, s.title) is None)


def _asked(chapter: str) -> Chapter:
    if chapter not in chapters():
        raise KeyError(chapter)
    asked: Chapter = importlib.import_module(f"hil.thesis.chapter{chapter.removeprefix('ch')}").CHAPTER
    return asked
