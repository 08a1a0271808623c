"""Latencies of packets in seconds: a constant, any scipy.stats law, a quantile table, or a recorded trace.

Whatever the source, a law of latencies becomes a piecewise linear quantile function: level u of [0, 1] to seconds.
Drawing is one bisection then, and only the process that composes a run of a rare law ever loads scipy.stats.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import cycle
from operator import le
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from transport.durations import UNITS, in_seconds
from transport.errors import FieldError, nearest
from transport.laws.standard_quantiles import SMALLEST_LEVEL, shapes_of, standard_quantiles
from transport.laws.trace import read_column

EARLY = 1e-6
MOST_SHAPE = 1e300
"""No parameter of a law is larger, and a whole number may be."""


def seconds(path: str, value: object) -> float:
    """Return a duration in seconds from a number (seconds) or a number with a unit.

    >>> seconds("scale", "3 ms"), seconds("scale", 2)
    (0.003, 2.0)
    """
    if isinstance(value, str):
        with suppress(ValueError):
            return in_seconds(value)
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        return float(value)
    raise FieldError(path, f"got {value!r}, expected a duration: a number of seconds, or one with a unit of {', '.join(UNITS)}")


@dataclass(frozen=True, slots=True, kw_only=True)
class QuantileTable:
    """Law of a latency by its quantile function, linear between knots.

    Equal values at two levels are an atom, two values at one level a gap in the support.

    Args:
        levels: (n,) rising from 0 to 1.
        values_s: (n,) not falling, seconds.
        cut: probability of a latency beyond the last value, where the law that is tabulated has no bound. What is drawn is the
            same with it or without, and so are two tables.
    """

    levels: tuple[float, ...]
    values_s: tuple[float, ...]
    cut: float = field(default=0.0, compare=False)

    def sampler(self) -> Callable[[float], float]:
        """Return the quantile function, level of [0, 1) to seconds, 0.2 us per call."""
        levels, values = list(self.levels), list(self.values_s)
        slopes = [
            (v1 - v0) / (l1 - l0) if l1 > l0 else 0.0
            for l0, l1, v0, v1 in zip(levels, levels[1:], values, values[1:], strict=False)
        ]

        def quantile(u: float) -> float:
            i = bisect_right(levels, u) - 1
            return values[i] + (u - levels[i]) * slopes[i]

        return quantile

    def in_order(self) -> Callable[[float], float]:
        """Return what gives one packet after the other its latency: here the quantile function."""
        return self.sampler()

    def cdf(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return Pr(latency <= x), same shape; x in seconds."""
        levels, values = np.array(self.levels), np.array(self.values_s)
        below = np.searchsorted(values, x, side="right")
        i = np.clip(below, 1, len(values) - 1)
        step = values[i] - values[i - 1]
        share = np.divide(x - values[i - 1], step, out=np.zeros(np.shape(x)), where=step > 0)
        inside = levels[i - 1] + share * (levels[i] - levels[i - 1])
        return np.asarray(np.where(below == 0, 0.0, np.where(below == len(values), 1.0, inside)), dtype=np.float64)

    @property
    def mean_s(self) -> float:
        """Mean latency in seconds."""
        return float(np.trapezoid(self.values_s, self.levels))

    @property
    def lost(self) -> float:
        """Share of packets without a latency: none."""
        return 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LatencyTrace:
    """Recorded latencies, one per slot from slot 0; infinite where the packet was lost. Copies draw any recorded
    latency.

    Args:
        values_s: (n,) seconds.
        repeat: begin again after the last one.
    """

    values_s: tuple[float, ...]
    repeat: bool

    def sampler(self) -> Callable[[float], float]:
        """Return the map from a level of [0, 1) to any recorded latency of a packet that arrived."""
        values = sorted(v for v in self.values_s if math.isfinite(v)) or [math.inf]
        return lambda u: values[int(u * len(values))]

    def in_order(self) -> Callable[[float], float]:
        """Return what gives one packet after the other its recorded latency; the argument is not used."""
        following = self._values().__next__
        return lambda u: following()

    def _values(self) -> Iterator[float]:
        yield from cycle(self.values_s) if self.repeat else self.values_s
        raise FieldError("latency.trace", f"has {len(self.values_s)} entries, the run needs more (past_end = 'refuse')")

    def cdf(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the recorded share of latencies <= x among the packets that arrived, same shape; x in seconds."""
        values = np.sort([v for v in self.values_s if math.isfinite(v)])
        return np.asarray(np.searchsorted(values, x, side="right") / max(len(values), 1), dtype=np.float64)

    @property
    def mean_s(self) -> float:
        """Mean latency in seconds of the packets that arrived."""
        values = [v for v in self.values_s if math.isfinite(v)]
        return math.fsum(values) / len(values) if values else math.nan

    @property
    def lost(self) -> float:
        """Share of lost packets."""
        return sum(math.isinf(v) for v in self.values_s) / len(self.values_s)


Latency = QuantileTable | LatencyTrace
LatencySpec = float | str | dict[str, Any]


def latency(spec: LatencySpec, directory: str | PathLike[str] | None = None) -> Latency:
    """Return the law that an experiment describes.

    Args:
        spec: a duration (constant); `{dist, ...}`: name and parameters of a scipy.stats law, `loc` and `scale`
            durations; `{table = [[level, duration], ...]}`: quantiles; `{trace = [duration or "lost", ...]}` or `{file
            = "x.csv"}` with the column `latency_s` (or the first one), both with `past_end = "repeat" | "refuse"`.
        directory: where a relative file name starts.

    Raises:
        ValueError: names the entry.

    >>> latency({"table": [[0, "1 ms"], [1, "3 ms"]]}).mean_s
    0.002
    """
    path = "latency"
    if not isinstance(spec, Mapping):
        value = _positive(path, spec)
        return QuantileTable(levels=(0.0, 1.0), values_s=(value, value))
    sources = [key for key in ("dist", "table", "trace", "file") if key in spec]
    if len(sources) != 1:
        raise FieldError(path, f"got the keys {list(spec)}, expected exactly one of dist, table, trace, file")
    if sources[0] == "dist":
        return _from_scipy(spec, path)
    _known(spec, ("table",) if sources[0] == "table" else (sources[0], "past_end"), path)
    if sources[0] == "table":
        return _from_table(spec["table"], path + ".table")
    past_end = spec.get("past_end", "repeat")
    if past_end not in ("repeat", "refuse"):
        raise FieldError(f"{path}.past_end", f'got {past_end!r}, expected "repeat" or "refuse"')
    entries = spec.get("trace")
    if sources[0] == "file":
        path += ".file"
        try:
            entries = [*read_column(Path(directory or ".") / str(spec["file"]), "latency_s")]
        except FieldError as fault:
            raise FieldError(path, fault.message) from None
    else:
        path += ".trace"
    if isinstance(entries, str) or not isinstance(entries, Sequence) or not entries:
        raise FieldError(path, f'got {entries!r:.60}, expected a list of durations (or "lost")')
    values = tuple(math.inf if v == "lost" else _positive(f"{path}[{k}]", v) for k, v in enumerate(entries))
    return LatencyTrace(values_s=values, repeat=past_end == "repeat")


def described(law: Latency) -> dict[str, Any]:
    """Return the experiment's description of a law, without files or names: the inverse of `latency`."""
    if isinstance(law, QuantileTable):
        return {"table": tuple(zip(law.levels, law.values_s, strict=True))}
    entries = tuple("lost" if math.isinf(v) else v for v in law.values_s)
    return {"trace": entries, "past_end": "repeat" if law.repeat else "refuse"}


def _positive(path: str, value: object) -> float:
    result = seconds(path, value)
    if not 0.0 <= result < math.inf:
        raise FieldError(path, f"got {result:g} s, expected a finite duration >= 0")
    return result


def _known(spec: Mapping[str, Any], names: Sequence[str], path: str) -> None:
    for key in spec:
        if key not in names:
            near = nearest(str(key), names)
            raise FieldError(f"{path}.{key}", f"unknown; expected {', '.join(names)}" + (f" ({near}?)" if near else ""))


def _from_table(rows: object, path: str) -> QuantileTable:
    if isinstance(rows, str) or not isinstance(rows, Sequence) or len(rows) < 2:
        raise FieldError(path, f"got {rows!r}, expected at least two rows [level, duration]")
    if all(type(row) is tuple and [*map(type, row)] == [float, float] for row in rows):  # as `described` gives it
        levels, values = (tuple(column) for column in zip(*rows, strict=True))
        rises = all(map(le, levels, levels[1:])) and all(map(le, values, values[1:]))
        if rises and levels[0] == 0.0 and levels[-1] == 1.0 and values[0] >= 0.0 and values[-1] < math.inf:
            return QuantileTable(levels=levels, values_s=values)
    knots: list[tuple[float, float]] = []
    for i, row in enumerate(rows):
        if isinstance(row, str) or not isinstance(row, Sequence) or len(row) != 2:
            raise FieldError(f"{path}[{i}]", f"got {row!r}, expected [level, duration]")
        level, value = seconds(f"{path}[{i}][0]", row[0]), _positive(f"{path}[{i}][1]", row[1])
        if (i == 0 and level != 0.0) or (i == len(rows) - 1 and level != 1.0):
            raise FieldError(f"{path}[{i}][0]", f"got {level:g}, expected levels from 0 to 1")
        if knots and not (level >= knots[-1][0] and value >= knots[-1][1]):
            raise FieldError(f"{path}[{i}]", f"[{level:g}, {value:g} s] falls below the row before, expected rising rows")
        knots.append((level, value))
    return QuantileTable(levels=tuple(level for level, _ in knots), values_s=tuple(value for _, value in knots))


def _from_scipy(spec: Mapping[str, Any], path: str) -> QuantileTable:
    name = spec["dist"]
    shapes = shapes_of(name, path)
    _known(spec, ["dist", *shapes, "loc", "scale"], path)
    arguments: dict[str, float] = {}
    for shape in shapes:
        if shape not in spec:
            raise FieldError(f"{path}.{shape}", f"missing; {name} has the parameters {', '.join([*shapes, 'loc', 'scale'])}")
        value = spec[shape]
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise FieldError(f"{path}.{shape}", f"got {value!r}, expected a number")
        if abs(value) > MOST_SHAPE:
            raise FieldError(f"{path}.{shape}", f"expected a number up to {MOST_SHAPE:g}")
        arguments[shape] = float(value)
    loc, scale = seconds(f"{path}.loc", spec.get("loc", 0.0)), seconds(f"{path}.scale", spec.get("scale", 1.0))
    if not scale > 0.0:
        raise FieldError(f"{path}.scale", f"got {scale:g} s, expected a positive duration")
    described_as = f"{name}({', '.join(f'{k}={v:g}' for k, v in arguments.items())})"
    levels, standard, end = standard_quantiles(name, arguments, path)
    with np.errstate(invalid="ignore", over="ignore"):  # what is not finite is refused below
        values = _kept(loc + scale * standard)
    if not np.isfinite(values).all() or (np.diff(values) < 0).any():
        raise FieldError(path, f"{described_as} is no law with these parameters")
    early = float(np.interp(0.0, values, levels)) if values[0] < 0.0 else 0.0
    if early > EARLY:
        raise FieldError(path, f"by {described_as} a share of {early:.2g} arrives before it is sent; shift it by loc")
    return QuantileTable(
        levels=tuple(levels.tolist()), values_s=tuple(np.maximum(values, 0.0).tolist()),
        cut=0.0 if math.isfinite(end) else SMALLEST_LEVEL,
    )  # fmt: skip


def _kept(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return quantiles rounded to 2^-24 of the middle one.

    scipy computes them by ``libm``, whose last bits differ from one processor to the next. A rounded one is the same on all of
    them, but where a tie lies between them: a table in some hundred thousand, and one knot of it differs then by 1e-7.
    """
    middle = float(values[len(values) // 2]) or float(np.abs(values).max())
    if not math.isfinite(middle) or middle == 0.0:
        return values
    unit = math.ldexp(1.0, math.frexp(middle)[1] - 24)
    return np.asarray(np.rint(values / unit) * unit)
