"""Laws of scipy.stats with location 0 and scale 1, as a piecewise linear quantile function.

What is asked for most comes from scipy.special: to import scipy.stats takes 0.6 s of CPU, more than all else of a short run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from transport.errors import FieldError, nearest
from transport.laws.stochastic_matrix import checked_row

Array = NDArray[np.float64]

SMALLEST_LEVEL = 2.0**-33
MOST_ATOMS = 100_000
SHAPES: Mapping[str, tuple[str, ...]] = {
    "gamma": ("a",), "lognorm": ("s",), "weibull_min": ("c",), "expon": (), "norm": (), "uniform": (),
}  # fmt: skip
"""Shapes, all above 0, of the laws whose quantiles stand here."""


class Quantiles(NamedTuple):
    """A law by its quantiles, as a frozen one of scipy.stats has them."""

    ppf: Callable[[Array], Any]
    isf: Callable[[Array], Any]
    ends: tuple[float, float] = (0.0, math.inf)

    def support(self) -> tuple[float, float]:
        return self.ends


def quantiles_of(name: str, shape: float = 1.0) -> Quantiles:
    """Return a law of `SHAPES`.

    Args:
        name: of the law.
        shape: its shape, above 0, where it has one.
    """
    from scipy.special import gammainccinv, gammaincinv, ndtri

    return {
        "gamma": Quantiles(lambda q: gammaincinv(shape, q), lambda q: gammainccinv(shape, q)),
        "lognorm": Quantiles(lambda q: np.exp(shape * ndtri(q)), lambda q: np.exp(shape * -ndtri(q))),
        "weibull_min": Quantiles(lambda q: np.power(-np.log1p(-q), 1.0 / shape), lambda q: np.power(-np.log(q), 1.0 / shape)),
        "expon": Quantiles(lambda q: -np.log1p(-q), lambda q: -np.log(q)),
        "norm": Quantiles(ndtri, lambda q: -ndtri(q), (-math.inf, math.inf)),
        "uniform": Quantiles(lambda q: q, lambda q: 1.0 - q, (0.0, 1.0)),
    }[name]


def shapes_of(name: object, path: str) -> Sequence[str]:
    """Return the names of a law's shape parameters.

    Args:
        name: of a law of scipy.stats.
        path: of the table that names it.

    Raises:
        FieldError: there is no such law.
    """
    if isinstance(name, str) and name in SHAPES:
        return SHAPES[name]
    return [shape.strip() for shape in (_family(name, path).shapes or "").split(",") if shape.strip()]


def standard_quantiles(name: str, shapes: Mapping[str, float], path: str) -> tuple[Array, Array, float]:
    """Return levels and quantiles of a law, and the end of its support.

    Args:
        name: of a law of scipy.stats.
        shapes: its shape parameters.
        path: of the table that names it.

    Raises:
        FieldError: it has too many possible values.
    """
    if name in SHAPES and all(shape > 0.0 for shape in shapes.values()):
        law = quantiles_of(name, *shapes.values())
        return *_knots(law), law.ends[1]
    from scipy import stats

    family = _family(name, path)
    frozen = family(**shapes)
    found = _atoms(frozen, path) if isinstance(family, stats.rv_discrete) else _knots(frozen)
    return *found, frozen.support()[1]


def _family(name: object, path: str) -> Any:
    """A law of scipy.stats."""
    from scipy import stats

    family = getattr(stats, name, None) if isinstance(name, str) else None
    if not isinstance(family, (stats.rv_continuous, stats.rv_discrete)):
        laws = [n for n, law in vars(stats).items() if isinstance(law, (stats.rv_continuous, stats.rv_discrete))]
        near = nearest(str(name), laws)
        raise FieldError(f"{path}.dist", f"scipy.stats has no law {name!r}" + (f"; did you mean {near!r}?" if near else ""))
    return family


def _knots(frozen: Any) -> tuple[Array, Array]:
    """Knots of a continuous law: 512 steps in the middle, 16 per factor 2 in the tails down to 2^-33.

    Level 0 and 1 belong to the ends of the support, or to the last knots where that is infinite: one packet in 10^10
    is cut.
    """
    tail = np.concatenate([np.ldexp(1.0 + np.arange(16) / 16.0, e) for e in range(-33, -5)])
    inner = np.concatenate([tail, np.linspace(2.0**-5, 1.0 - 2.0**-5, 513), (1.0 - tail)[::-1]])
    with np.errstate(over="ignore"):  # a quantile beyond all numbers is infinite, and refused as such
        values = np.concatenate([frozen.ppf(inner[: len(tail) + 513]), frozen.isf(tail[::-1])])
    ends = np.array(frozen.support(), dtype=np.float64)
    ends = np.where(np.isfinite(ends), ends, values[[0, -1]])
    return np.concatenate([[0.0], inner, [1.0]]), np.concatenate([ends[:1], values, ends[1:]])


def _atoms(frozen: Any, path: str) -> tuple[Array, Array]:
    """Knots of a discrete law: every atom is a flat piece."""
    mean = float(frozen.mean())
    middle = mean if math.isfinite(mean) else frozen.support()[0]
    # Asked before the quantiles are, which scipy seeks atom by atom: under zipf(1.2) for hours.
    if frozen.sf(middle + MOST_ATOMS) > SMALLEST_LEVEL:
        raise FieldError(path, f"has more than {MOST_ATOMS} possible values, expected fewer")
    low, high = frozen.ppf([SMALLEST_LEVEL, 1.0 - SMALLEST_LEVEL])
    if not high - low < MOST_ATOMS:
        raise FieldError(path, f"has {high - low:g} possible values, expected fewer than {MOST_ATOMS}")
    atoms = np.arange(low, high + 1.0)
    row = np.asarray(frozen.pmf(atoms), dtype=np.float64)
    checked_row(path, (row / row.sum()).tolist())
    reached = np.rint(np.concatenate([[0.0], np.cumsum(row / row.sum())]) / SMALLEST_LEVEL) * SMALLEST_LEVEL
    reached[-1] = 1.0
    return np.repeat(reached, 2)[1:-1], np.repeat(atoms, 2)
