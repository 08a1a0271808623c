"""The signals that numbers and pictures are about: outputs, those that follow the reference, inputs, with their units.

Outputs and the reference that they follow are read in blocks: a long run is never whole in memory.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeAlias, runtime_checkable

import numpy as np
import numpy.typing as npt
from msgspec import Struct
from msgspec.structs import replace

if TYPE_CHECKING:
    from plants.parts.protocols import Plant

PURE = ("", "1")
"""Units of a pure number."""


@runtime_checkable
class NamesTracked(Protocol):
    """A plant of which some outputs only follow the reference: it names them (a measured mode follows nothing)."""

    @property
    def tracked(self) -> tuple[str, ...]: ...


class Signals(Struct, frozen=True, kw_only=True):
    """Names and units of a loop's signals.

    Args:
        outputs, inputs: name to unit, in order; no unit for a pure number.
        tracked: the outputs that shall follow the reference, in order.
    """

    outputs: Mapping[str, str]
    inputs: Mapping[str, str]
    tracked: tuple[str, ...]

    def tracked_unit(self) -> str | None:
        """Return the unit that all tracked outputs share, None if they differ."""
        return common(self.outputs[name] for name in self.tracked)

    def input_unit(self) -> str | None:
        """Return the unit that all inputs share, None if they differ."""
        return common(self.inputs.values())

    def only(self, name: str) -> Signals:
        """Return the same signals with one tracked output."""
        return replace(self, tracked=(name,))

    def in_unit(self, unit: str) -> Signals:
        """Return the same signals with one word as the unit of every output, for a table whose columns name the units."""
        return replace(self, outputs=dict.fromkeys(self.outputs, unit))


def signals_of(plant: Plant) -> Signals:
    """Return the signals of a plant; all outputs are tracked unless it names those that are (`NamesTracked`)."""
    outputs = {s.name: bare(s.unit) for s in plant.outputs}
    tracked = tracked_among(plant, outputs)
    return Signals(outputs=outputs, inputs={s.name: bare(s.unit) for s in plant.inputs}, tracked=tracked)


def tracked_among(plant: object, outputs: Iterable[str]) -> tuple[str, ...]:
    """Return those of some outputs that shall follow the reference."""
    return tuple(name for name in outputs if not isinstance(plant, NamesTracked) or name in plant.tracked)


def bare(unit: str) -> str:
    """Return a unit, nothing for a pure number."""
    return "" if unit in PURE else unit


def common(units: Iterable[str]) -> str | None:
    """Return the unit that all share, None if they differ or there are none.

    >>> common(["rad", "rad"]), common(["kn", "deg"])
    ('rad', None)
    """
    found = set(map(bare, units))
    return found.pop() if len(found) == 1 else None


def with_unit(text: str, unit: str) -> str:
    """Return a label with its unit in brackets.

    >>> with_unit("angle", "rad"), with_unit("mode", "1")
    ('angle (rad)', 'mode')
    """
    return text if unit in PURE else f"{text} ({unit})"


LEAF: Final = 1 << 15
"""Entries that are summed at once; numpy itself goes on halving down to 128."""


def pairwise_sum(of: Callable[[int, int], npt.NDArray[np.floating[Any]]], n: int, begin: int = 0) -> float:
    """Return the sum of n numbers by halves: s(n) = s(m) + s(n - m), m = n/2 less n/2 mod 8, as `numpy.sum` adds a column.

    It is bit for bit numpy's sum of a column that is never whole in memory.

    Args:
        of: returns the entries from i to j - 1.
        n: how many there are.
        begin: the first of them.

    Reference: N. J. Higham, The accuracy of floating point summation, SIAM J. Sci. Comput. 14 (1993), section 2.

    >>> column = np.arange(100_000) / 7.0
    >>> pairwise_sum(lambda i, j: column[i:j], len(column)) == np.sum(column)
    np.True_
    """
    if n <= LEAF:
        return float(np.sum(of(begin, begin + n)))
    half = n // 2
    half -= half % 8
    return pairwise_sum(of, half, begin) + pairwise_sum(of, n - half, begin + half)


Array: TypeAlias = npt.NDArray[np.float64]


class Followed(Struct, frozen=True, kw_only=True):
    """Times, outputs and reference of the slots that have both.

    Args:
        slots: how many there are, n.
        of: returns times in s (j - i,), outputs and reference (j - i, p) each, of the slots from i to j - 1.
    """

    slots: int
    of: Callable[[int, int], tuple[Array, Array, Array]]

    def blocks(self, begin: int = 0, end: int | None = None) -> Iterator[tuple[int, int]]:
        """Give the bounds of blocks, in order."""
        end = self.slots if end is None else end
        for i in range(begin, end, LEAF):
            yield i, min(i + LEAF, end)

    def time(self, slot: int) -> float:
        """Return the time of a slot, s."""
        return float(self.of(slot, slot + 1)[0][0])

    def reference(self, slot: int) -> Array:
        """Return the reference in a slot, (p,)."""
        row: Array = self.of(slot, slot + 1)[2][0]
        return row

    def first_at(self, t_s: float) -> int:
        """Return the first slot that is not before an instant, n if all are."""
        return bisect_left(range(self.slots), t_s, key=self.time)

    def changes(self, most: int) -> list[int]:
        """Return the first slots at which the reference differs from that of the slot before, so many at most."""
        found: list[int] = []
        for i, j in self.blocks():
            before = max(i - 1, 0)
            r = self.of(before, j)[2]
            found += (np.flatnonzero(np.any(r[1:] != r[:-1], axis=1)) + before + 1).tolist()
            if len(found) >= most:
                break
        return found[:most]


SETTLING_BAND = 0.02
"""Half width of the settling band, as a share of the step."""

SETTLED_SHARE = 0.1
"""Last share of the window that must lie in the band: a run that only crosses the band at its end has not settled."""

STEADY_SHARE = 0.1
"""Last share of the run over which the steady-state error is averaged."""

AFTER_S = 5.0
"""Begin of `sse_after_5s`, session time in s."""


def target_of(reference: Array) -> Array:
    """Return what the error counts against, (n, p): the reference, and before its first change the value that it goes to."""
    target: Array = reference.copy()
    changes = np.flatnonzero(np.any(reference[1:] != reference[:-1], axis=1)) + 1
    if changes.size:
        target[: changes[0]] = reference[changes[0]]
    return target
