"""Where a sweep over parameters runs: all points of a grid, or a Latin hypercube over ranges."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from hil.errors import HilError

MOST_POINTS = 10_000


class Points(Struct, frozen=True, kw_only=True):
    """Where an experiment is run.

    Args:
        keys: paths of the fields that change.
        values: one row per point: what each field is set to, in TOML notation.
        axes: the values of each key, where the points are a grid; nothing otherwise.
    """

    keys: tuple[str, ...]
    values: tuple[tuple[str, ...], ...]
    axes: tuple[tuple[str, ...], ...] = ()

    def changes(self, point: int) -> list[str]:
        """Return what a point changes, as ``--set`` takes it."""
        return [f"{key}={value}" for key, value in zip(self.keys, self.values[point])]


def grid(arguments: Sequence[str]) -> Points:
    """Return all combinations of the values of several keys, the last key changing first.

    Args:
        arguments: ``key=a,b,c`` each; commas within brackets, braces and quotes belong to a value.

    Raises:
        HilError: for another form, a key or a value that is named twice, or too many points.

    >>> grid(["period=10 ms,20 ms", "plant.gain=150,170"]).values
    (('10 ms', '150'), ('10 ms', '170'), ('20 ms', '150'), ('20 ms', '170'))
    """
    axes: dict[str, list[str]] = {}
    for text in arguments:
        key, equal, listed = text.partition("=")
        values = split_values(listed)
        if not equal or not key.strip() or not all(values):
            raise HilError(f"grid {text!r:.60}: expected key=a,b,c, such as period=10ms,25ms")
        if key.strip() in axes:
            raise HilError(f"grid {key.strip()}: named twice")
        axes[key.strip()] = values
    return grid_of(axes)


def grid_of(values: Mapping[str, Sequence[str]]) -> Points:
    """Return all combinations of the values of several keys, the last key changing first.

    Args:
        values: key to what it is set to, as ``--set`` takes it.

    Raises:
        HilError: too many points, or a value that stands there twice.
    """
    axes = tuple(tuple(map(with_space, listed)) for listed in values.values())
    count = int(np.prod([len(axis) for axis in axes], dtype=np.float64))
    if count > MOST_POINTS:
        raise HilError(f"grid: {count} points; at most {MOST_POINTS}")
    for key, axis in zip(values, axes):
        numbers, _ = numbers_of(axis)
        different = len(set(axis if numbers is None else numbers.tolist()))
        if different < len(axis):
            raise HilError(f"grid {key}: {', '.join(axis):.60}: {different} of {len(axis)} values differ; name each once")
    return Points(keys=tuple(values), values=tuple(itertools.product(*axes)), axes=axes)


def latin_hypercube(arguments: Sequence[str], count: int, seed: int = 0) -> Points:
    """Return points that fill a box evenly: every key takes one value in each of ``count`` equal parts of its range.

    Args:
        arguments: ``key=low:high`` each, with one unit for both where there is one: ``period=10ms:50ms``.
        count: number of points.
        seed: of the points, not of the runs.

    Raises:
        HilError: for another form, a key that is named twice, or too many points.

    Reference: M. McKay, R. Beckman, W. Conover, Technometrics 21 (1979) 239-245.
    """
    from scipy.stats import qmc

    if not 1 <= count <= MOST_POINTS:
        raise HilError(f"points: {count}; expected 1 to {MOST_POINTS}")
    ranges: dict[str, tuple[float, float, str]] = {}
    for text in arguments:
        key, _, span = text.partition("=")
        ends = [with_space(end).partition(" ") for end in span.split(":")]
        try:
            low, high = (float(number) for number, _, _ in ends)
        except ValueError:
            raise HilError(f"range {text!r:.60}: expected key=low:high, such as plant.gain=100:200") from None
        unit = ends[1][2]
        if not (np.isfinite((low, high)).all() and low < high) or ends[0][2] not in ("", unit):
            raise HilError(f"range {text!r:.60}: expected two finite numbers, the lower first, in one unit")
        if key.strip() in ranges or not key.strip():
            raise HilError(f"range {text!r:.60}: the key is missing or repeated")
        ranges[key.strip()] = low, high, unit
    lows, highs, units = zip(*ranges.values())
    points = qmc.scale(qmc.LatinHypercube(d=len(ranges), rng=np.random.default_rng(seed)).random(count), lows, highs)
    rows = [tuple(f"{value:.6g}{f' {unit}' if unit else ''}" for value, unit in zip(row, units)) for row in points.tolist()]
    return Points(keys=tuple(ranges), values=tuple(rows))


def split_values(text: str) -> list[str]:
    """Return the values of a list without brackets.

    >>> split_values("1, [2, 3],'a,b'")
    ['1', '[2, 3]', "'a,b'"]
    """
    found, depth, quote, start = [], 0, "", 0
    for i, c in enumerate(text):
        if quote:
            quote = "" if c == quote else quote
        elif c in "\"'":
            quote = c
        elif c in "[{":
            depth += 1
        elif c in "]}":
            depth -= 1
        elif c == "," and depth == 0:
            found.append(text[start:i].strip())
            start = i + 1
    return [*found, text[start:].strip()]


def with_space(text: str) -> str:
    """Return a number that stands against its unit with a space between them; anything else as it is.

    >>> with_space("10ms"), with_space("1e-3"), with_space("markov")
    ('10 ms', '1e-3', 'markov')
    """
    stripped = text.strip()
    number = stripped.rstrip("abcdefghijklmnopqrstuvwxyz").rstrip()
    unit = stripped[len(number) :].strip()
    try:
        float(number)
    except ValueError:
        return stripped
    return f"{number} {unit}" if unit else number


def numbers_of(axis: Sequence[str]) -> tuple[NDArray[np.float64] | None, str]:
    """Return the numbers of an axis and their unit, no numbers where they are words or have several units.

    >>> numbers_of(("10 ms", "25ms"))
    (array([10., 25.]), 'ms')
    """
    parts = [with_space(text).partition(" ") for text in axis]
    try:
        x = np.array([float(number) for number, _, _ in parts])
    except ValueError:
        return None, ""
    units = {unit for _, _, unit in parts}
    return (x, units.pop()) if len(units) == 1 and np.isfinite(x).all() else (None, "")
