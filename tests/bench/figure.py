"""A figure: a number of ours, its peer from the same run, their ratio, and what has to be reached. Less is always better."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Final

Row = dict[str, Any]
Tell = Callable[[str], None]
"""Is called with what is being measured."""

NOT_JUDGED: Final = "not judged: --quick measures smaller things"


@dataclass(frozen=True, slots=True, kw_only=True)
class AtMost:
    """What a number may be, at most; both where both are given.

    Args:
        ours: in the figure's unit.
        ratio: times its peer.
        plus: and so much more than that, in the figure's unit.
    """

    ours: float | None = None
    ratio: float | None = None
    plus: float = 0.0

    def met(self, ours: float, peer: float | None) -> bool:
        """Return whether a number is small enough.

        >>> AtMost(ratio=3.0, plus=0.5).met(0.8, 0.1), AtMost(ours=10.0).met(11.0, None), AtMost(ratio=2.0).met(0.0, 0.0)
        (True, False, True)
        """
        if self.ours is not None and not ours <= self.ours:
            return False
        return self.ratio is None or (peer is not None and ours <= self.ratio * peer + self.plus)

    def text(self, unit: str) -> str:
        """Return it in words.

        >>> AtMost(ours=1.5).text("s"), AtMost(ratio=3.0, plus=0.5).text("%")
        ('1.5 s', '3 times the peer + 0.5 %')
        """
        reported = [] if self.ours is None else [f"{self.ours:g} {unit}".strip()]
        if self.ratio is not None:
            reported.append(f"{self.ratio:.3g} times the peer" + (f" + {self.plus:g} {unit}" if self.plus else ""))
        return ", ".join(reported)


FLAT: Final = AtMost(ratio=1.5)
"""What memory may be where there is ten times as much to do: it does not grow with it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """What is measured.

    Args:
        name: says it in a few words; no two figures share one.
        unit: of both numbers.
        peer: what stands beside ours.
        goal: what ours should be; a miss is reported.
        condition: what ours has to be on any machine.
    """

    name: str
    unit: str
    peer: str
    goal: AtMost | None = None
    condition: AtMost | None = None


@dataclass(frozen=True, slots=True)
class Found:
    """What was measured of the figure of that name.

    Args:
        name: of the figure.
        ours, peer: its numbers; a peer may be missing where the machine lacks its tool.
        note: what else there is to say.
        between: 95 % interval of the true ratio, where both are shares of few events; a goal that it holds is undecided, but for
            one that leaves something beside the ratio.
        unfinished: ours was stopped at this number, and would be larger.
    """

    name: str
    ours: float
    peer: float | None
    note: str = ""
    between: tuple[float, float] | None = None
    unfinished: bool = False


@dataclass(frozen=True, slots=True)
class Measure:
    """Figures that are measured together: what one of them lacks, all of them lack.

    Args:
        figures: what is measured.
        take: measures them, small and quickly where its second argument says so.
        loops: whether slots run in it, so that it is measured compiled, too.
    """

    figures: tuple[Figure, ...]
    take: Callable[[Tell, bool], Iterable[Found]]
    loops: bool = False


@dataclass(frozen=True, slots=True)
class Part:
    """Some measures that run one after the other, each in a process of its own.

    Args:
        name: by which it is asked for.
        about: what it measures.
        seconds: about how long it takes on two quiet CPUs, in both forms.
        measures: in order.
    """

    name: str
    about: str
    seconds: float
    measures: tuple[Measure, ...]

    @property
    def figures(self) -> tuple[Figure, ...]:
        """All of them, in order."""
        return tuple(figure for measure in self.measures for figure in measure.figures)


def row_of(part: str, figure: Figure, found: Found | None, why: str = "", *, quick: bool = False) -> Row:
    """Return a figure as it is printed: what it is, its numbers, their ratio, and whether it reaches what it has to.

    Args:
        part: name of its part.
        figure: what was to be measured.
        found: what was measured, None if nothing was.
        why: why not.
        quick: whether something smaller was measured, of which nothing is judged.
    """
    row: Row = {"part": part, "name": figure.name, "ours": None, "peer": None, "ratio": None, "unit": figure.unit}
    row |= {"peer_is": figure.peer, "note": ""}
    if found is not None:
        ratio = found.ours / found.peer if found.peer else None
        row |= {"ours": _rounded(found.ours), "peer": _rounded(found.peer), "ratio": _rounded(ratio), "note": found.note}
    for key, most in (("goal", figure.goal), ("condition", figure.condition)):
        row[key] = None if most is None else most.text(figure.unit)
        row[f"{key}_verdict"] = None if most is None and key == "condition" else _verdict(most, found, why, quick)
    return row


NUMBERS: Final = ("ours", "peer", "ratio", "note", "goal_verdict", "condition_verdict")
"""Of a row: what differs between the two forms of the loop."""


def in_both_forms(row: Row, compiled: Row) -> Row:
    """Return a row of the interpreted loop with the numbers of the compiled one, under `compiled`: they are what is judged."""
    return row | {"compiled": {key: compiled[key] for key in NUMBERS}}


def judged(row: Row) -> Row:
    """Return the numbers by which a figure is judged: of the compiled loop where it was measured.

    >>> judged({"ours": 2.0, "compiled": {"ours": 1.0}}), judged({"ours": 2.0})
    ({'ours': 1.0}, {'ours': 2.0})
    """
    found: Row = row.get("compiled") or row
    return found


def _verdict(most: AtMost | None, found: Found | None, why: str, quick: bool) -> str:
    if found is None:
        return f"not measured: {why}"
    if most is None:
        return "measured"
    if quick:
        return NOT_JUDGED
    if most.ratio is not None and found.peer is None:
        return "not measured: its peer is missing"
    between = None if most.plus else found.between  # what may be added to a ratio decides where both count next to nothing
    if most.ratio is not None and between is not None and between[0] <= most.ratio < between[1]:
        return f"undecided: the ratio is between {between[0]:.2g} and {between[1]:.2g}"
    return "reached" if most.met(found.ours, found.peer) and not found.unfinished else "missed"


def _rounded(value: float | None) -> float | None:
    """Four digits; what is no number is nothing."""
    return None if value is None or value != value else float(f"{value:.4g}")
