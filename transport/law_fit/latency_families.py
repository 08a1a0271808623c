"""Distributions of latencies by likelihood: scipy's, and a table of quantiles that takes no side.

    l(theta) = sum over what came of log f(L; theta)

Every family with a shape has its threshold (loc) profiled out: for a given threshold the other parameters follow from sums, or
from one equation. Gamma and Weibull shapes below 1 are no maximum together with a threshold (the likelihood has no bound), and
are tried at threshold 0 alone. What was overtaken enters the likelihood by log S(c).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from scipy import optimize, special

from transport.law_fit.packet_record import Array

LARGEST_TABLE = 256
IMPOSSIBLE = 1e300
TIES = 0.05
"""A record with so few different values, as a share of all, has atoms."""


class LatencyFit(Struct, frozen=True, kw_only=True, eq=False):
    """A distribution of latencies.

    Attributes:
        name: of the family, "constant" or "table".
        spec: as an experiment writes it, see `transport.laws.latency.latency`.
        parameters: how many were estimated.
        log_likelihood: of what came, -inf where the family cannot give it.
        cdf: Pr(L <= x), array to array; `below`: Pr(L < x), which differs at atoms.
    """

    name: str
    spec: float | dict[str, Any]
    parameters: int
    log_likelihood: float
    cdf: Callable[[Array], Array]
    below: Callable[[Array], Array]


def fit_latencies(values: Array, censored: Array) -> list[LatencyFit]:
    """Return the fits of all families, the best by BIC first.

    Args:
        values: (n,) latencies of what came, s.
        censored: (m,) of what was overtaken: its latency is above these, s.
    """
    distinct = np.unique(values)
    if len(distinct) == 1:
        return [_constant(float(distinct[0]))]
    if len(distinct) <= max(TIES * len(values), 2):
        return [_atoms(values, censored)]
    found = [*_families(values), _table(values)]
    if len(censored):
        found = [_with_censored(fit, censored) for fit in found]
    n = len(values) + len(censored)
    return sorted((f for f in found if np.isfinite(f.log_likelihood)), key=lambda f: bic(f.log_likelihood, f.parameters, n))


def bic(log_likelihood: float, parameters: int, n: int) -> float:
    """Return Schwarz's criterion, -2 l + p log n: smaller is better."""
    return parameters * math.log(n) - 2.0 * log_likelihood


def _constant(value: float) -> LatencyFit:
    return LatencyFit(
        name="constant", spec=value, parameters=1, log_likelihood=0.0, cdf=lambda x: (x >= value).astype(np.float64),
        below=lambda x: (x > value).astype(np.float64),
    )  # fmt: skip


def _frozen(name: str, shapes: dict[str, float], loc: float, scale: float, free: int, values: Array) -> LatencyFit:
    from scipy import stats  # half a second of CPU

    law = getattr(stats, name)(*shapes.values(), loc=loc, scale=scale)
    spec = {"dist": name, **shapes} | ({"loc": loc} if loc else {}) | {"scale": scale}
    return LatencyFit(
        name=name, spec=spec, parameters=free, log_likelihood=float(law.logpdf(values).sum()), cdf=law.cdf, below=law.cdf
    )  # fmt: skip


def _families(values: Array) -> Iterator[LatencyFit]:
    low, high, mean, sd = float(values.min()), float(values.max()), float(values.mean()), float(values.std())
    yield _frozen("uniform", {}, low, high - low, 2, values)
    yield _frozen("expon", {}, low, mean - low, 2, values)
    if low > 0.0:
        yield _frozen("expon", {}, 0.0, mean, 1, values)
    if mean > 5.5 * sd:  # so that none arrives before it is sent
        yield _frozen("norm", {}, mean, sd, 2, values)
    for name, shape_of, least in (
        ("gamma", _gamma_shape, 1.0),
        ("lognorm", _lognorm_shape, 0.0),
        ("weibull_min", _weibull_shape, 1.0),
    ):
        if low > 0.0:
            shapes, scale = shape_of(values)
            yield _frozen(name, shapes, 0.0, scale, 2, values)
        threshold = _threshold(values, name, shape_of)
        if threshold is not None:
            shapes, scale = shape_of(values - threshold)
            if next(iter(shapes.values())) > least:
                yield _frozen(name, shapes, threshold, scale, 3, values)


def _threshold(values: Array, name: str, shape_of: Callable[[Array], tuple[dict[str, float], float]]) -> float | None:
    """Return the threshold of the largest likelihood, over a grid in the logarithm of its distance to the smallest value."""
    from scipy import stats

    ordered = np.sort(values)
    low, spread = float(ordered[0]), float(ordered[-1] - ordered[0])
    few = ordered[:: max(1, len(ordered) // 20_000)]
    few = few if few[0] == low else np.concatenate([[low], few])
    family = getattr(stats, name)

    def cost(logarithm: float) -> float:
        loc = low - spread * math.exp(logarithm)
        if loc < 0.0:
            return IMPOSSIBLE
        shapes, scale = shape_of(few - loc)
        return -float(family.logpdf(few - loc, *shapes.values(), scale=scale).sum())

    grid = [(cost(x), x) for x in np.linspace(math.log(1.0 / len(values)) - 2.0, 1.0, 24).tolist()]
    best, at = min(grid)
    if best >= IMPOSSIBLE:
        return None
    found = optimize.minimize_scalar(cost, bounds=(at - 0.7, at + 0.7), method="bounded", options={"xatol": 1e-3})
    return low - spread * math.exp(float(found.x) if found.fun < best else at)


def _gamma_shape(x: Array) -> tuple[dict[str, float], float]:
    """log a - psi(a) = log mean(x) - mean(log x)."""
    mean = float(x.mean())
    gap = max(math.log(mean) - float(np.log(x).mean()), 1e-12)
    start = (3.0 - gap + math.sqrt((gap - 3.0) ** 2 + 24.0 * gap)) / (12.0 * gap)
    a = start
    for _ in range(20):
        step = (math.log(a) - float(special.psi(a)) - gap) / (1.0 / a - float(special.polygamma(1, a)))
        a = max(a - step, a / 2.0)
        if abs(step) < 1e-12 * a:
            break
    return {"a": a}, mean / a


def _lognorm_shape(x: Array) -> tuple[dict[str, float], float]:
    logarithms = np.log(x)
    return {"s": max(float(logarithms.std()), 1e-9)}, math.exp(float(logarithms.mean()))


def _weibull_shape(x: Array) -> tuple[dict[str, float], float]:
    """sum x^c log x / sum x^c - 1/c = mean(log x), by Newton's method; x scaled to 1."""
    unit = float(x.max())
    logarithms = np.log(x / unit)
    mean, c = float(logarithms.mean()), 1.2 / max(float(logarithms.std()), 1e-9)
    for _ in range(50):
        powers = np.exp(c * logarithms)
        total, first, second = powers.sum(), float(powers @ logarithms), float(powers @ logarithms**2)
        error = first / total - 1.0 / c - mean
        step = error / (second / total - (first / total) ** 2 + 1.0 / c**2)
        c = max(c - step, c / 2.0)
        if abs(step) < 1e-10 * c:
            break
    return {"c": float(c)}, unit * float(np.exp(c * logarithms).mean()) ** (1.0 / float(c))


def _table(values: Array) -> LatencyFit:
    """Equal shares between knots, of 25 packets at least."""
    n = len(values)
    cells = min(LARGEST_TABLE, max(8, n // 25))
    levels = np.linspace(0.0, 1.0, cells + 1)
    knots = np.quantile(values, levels)
    widths = np.diff(knots)
    inside = np.clip(np.searchsorted(knots, values, side="right") - 1, 0, cells - 1)
    with np.errstate(divide="ignore"):
        density = np.where(widths > 0.0, 1.0 / cells / np.maximum(widths, 1e-300), np.inf)
    likelihood = float(np.log(density[inside]).sum()) if np.isfinite(density).all() else -math.inf
    if not math.isfinite(likelihood):
        return _atoms(values, np.empty(0))

    def cdf(x: Array) -> Array:
        return np.asarray(np.interp(x, knots, levels, left=0.0, right=1.0), dtype=np.float64)

    spec = {"table": [[float(level), float(value)] for level, value in zip(levels, knots)]}
    return LatencyFit(name="table", spec=spec, parameters=cells + 1, log_likelihood=likelihood, cdf=cdf, below=cdf)


def _atoms(values: Array, censored: Array) -> LatencyFit:
    """The share of every value that came; shares of censored ones go to what is above them (Kaplan and Meier 1958)."""
    atoms, counts = np.unique(values, return_counts=True)
    risk = np.array([(values >= atom).sum() + (censored >= atom).sum() for atom in atoms], dtype=np.float64)
    survival = np.cumprod(1.0 - counts / risk)
    levels = 1.0 - survival
    levels[-1] = 1.0
    before = np.concatenate([[0.0], levels[:-1]])
    shares = np.maximum(levels - before, 1e-300)
    spec = {"table": [[float(v), float(a)] for a, b, e in zip(atoms, before, levels) for v in (b, e)]}

    def cdf(x: Array) -> Array:
        return np.asarray(np.concatenate([[0.0], levels])[np.searchsorted(atoms, x, side="right")])

    def below(x: Array) -> Array:
        return np.asarray(np.concatenate([[0.0], levels])[np.searchsorted(atoms, x, side="left")])

    return LatencyFit(
        name="table", spec=spec, parameters=len(atoms) - 1, log_likelihood=float(counts @ np.log(shares)), cdf=cdf, below=below
    )  # fmt: skip


def _with_censored(fit: LatencyFit, censored: Array) -> LatencyFit:
    """The same fit, its likelihood with log S(c) of what was overtaken."""
    survival = 1.0 - fit.cdf(censored)
    with np.errstate(divide="ignore"):
        more = float(np.log(survival).sum())
    return replace(fit, log_likelihood=fit.log_likelihood + more)
