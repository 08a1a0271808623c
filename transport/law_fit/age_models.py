"""Ages as a Markov or semi-Markov chain, by likelihood: what is fitted where latencies are not independent.

Both likelihoods are of the same slots, from the first change of age to the last, so that their BIC can be compared.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from scipy import optimize, special

from transport.law_fit.latency_families import bic
from transport.law_fit.packet_record import Ages, Array
from transport.law_fit.proportions import Interval, interval_of

MOST_AGES = 40
STRONG = 6.0
"""Difference of BIC that is strong evidence (Raftery 1995): of laws that nearly tie, the one with less memory is taken."""


class AgeFit(Struct, frozen=True, kw_only=True, eq=False):
    """A law of ages.

    Attributes:
        kind: "markov" or "semi-markov".
        spec: as an experiment writes it.
        log_likelihood, parameters: over the slots that both kinds use.
        slots: how many these are.
        low, high: (slots,) Pr(age < a) and Pr(age <= a) of what came next, given the past.
        intervals: with 95 % confidence, by the field's path.
        counts: (m, m) transitions between ages of consecutive slots, in the order of `ages`.
        ages: (m,) that came.
    """

    kind: str
    spec: dict[str, Any]
    log_likelihood: float
    parameters: int
    slots: int
    low: Array
    high: Array
    intervals: dict[str, Interval]
    counts: NDArray[np.int64]
    ages: Ages

    @property
    def score(self) -> float:
        """BIC, smaller is better."""
        return bic(self.log_likelihood, self.parameters, self.slots)


def fit_ages(ages: Ages) -> list[AgeFit]:
    """Return the Markov and the semi-Markov fit, the better by BIC first; none where the age does not change often enough.

    Args:
        ages: (n,) of the newest packet, slot by slot.
    """
    changes = np.flatnonzero(np.diff(ages)) + 1
    kinds, states = np.unique(ages, return_inverse=True)
    if len(changes) < 20 or len(kinds) > MOST_AGES:
        return []
    inner = states[changes[0] : changes[-1] + 1]
    size = len(kinds)
    counts = np.zeros((size, size), dtype=np.int64)
    np.add.at(counts, (inner[:-1], inner[1:]), 1)
    if not counts.sum(axis=1).all():
        return []
    starts = np.concatenate([[0], np.flatnonzero(np.diff(inner)) + 1])
    plain, stays = _markov(inner, counts, kinds), _semi_markov(inner, starts, counts, kinds)
    return [stays, plain] if stays.score < plain.score - STRONG else [plain, stays]


def _spec(kind: str, rows: Array, kinds: Ages, **more: Any) -> dict[str, Any]:
    """The law as an experiment writes it. Sums of rows are 1 to the last bit that counts: the largest entry takes the rest."""
    found = rows.copy()
    for row in found:
        row[int(row.argmax())] += 1.0 - row.sum()
    i, j = np.nonzero(rows)
    gaps = {"allow_gaps": True} if (kinds[j] > kinds[i] + 1).any() else {}
    return {"kind": kind, "matrix": found.tolist(), "ages": kinds.tolist(), **more, **gaps}


def _markov(inner: NDArray[np.int64], counts: NDArray[np.int64], kinds: Ages) -> AgeFit:
    totals = counts.sum(axis=1)
    rows = counts / totals[:, None]
    with np.errstate(divide="ignore"):
        logarithms = np.where(counts > 0, np.log(np.maximum(rows, 1e-300)), 0.0)
    reached = np.cumsum(rows, axis=1)
    now, then = inner[:-1], inner[1:]
    intervals = {f"matrix[{i}][{j}]": interval_of(float(counts[i, j]), float(totals[i])) for i, j in np.ndindex(counts.shape)}
    return AgeFit(
        kind="markov", spec=_spec("markov", rows, kinds), log_likelihood=float((counts * logarithms).sum()), counts=counts,
        ages=kinds, parameters=int((counts > 0).sum() - len(kinds)), slots=len(now), low=reached[now, then] - rows[now, then],
        high=np.minimum(reached[now, then], 1.0), intervals=intervals,
    )  # fmt: skip


def _semi_markov(inner: NDArray[np.int64], starts: NDArray[np.int64], counts: NDArray[np.int64], kinds: Ages) -> AgeFit:
    size, lengths = len(kinds), np.diff(starts)  # the last stay is of one slot, and has no end
    modes = inner[starts]
    jumps = counts.astype(np.float64)
    np.fill_diagonal(jumps, 0.0)
    leaving = jumps.sum(axis=1)
    rows = jumps / leaving[:, None]
    likelihood = float((jumps * np.log(np.where(jumps > 0, rows, 1.0))).sum())
    parameters = int((jumps > 0).sum()) - size
    sojourns: list[dict[str, Any]] = []
    hazards: list[Array] = []
    intervals: dict[str, Interval] = {}
    longest = int(lengths.max())
    for mode in range(size):
        stays = lengths[modes[:-1] == mode]
        spec, share, value, free = _sojourn(stays)
        sojourns.append(spec)
        likelihood, parameters = likelihood + value, parameters + free
        after = 1.0 - np.cumsum(np.append(share, np.zeros(max(0, longest - len(share)))))
        before = np.concatenate([[1.0], after[:-1]])[:longest]
        hazards.append(1.0 - np.clip(after[:longest] / np.maximum(before, 1e-300), 0.0, 1.0))
        intervals |= {
            f"matrix[{mode}][{j}]": interval_of(float(jumps[mode, j]), float(leaving[mode])) for j in range(size) if j != mode
        }
    spent = np.arange(len(inner)) - np.repeat(starts, np.append(lengths, 1))
    now, then = inner[:-1], inner[1:]
    leave = np.array(hazards)[now, np.minimum(spent[:-1], longest - 1)]
    chance = rows[now] * leave[:, None]
    chance[np.arange(len(now)), now] = 1.0 - leave
    reached = np.cumsum(chance, axis=1)
    at = np.arange(len(now)), then
    return AgeFit(
        kind="semi-markov", spec=_spec("semi-markov", rows, kinds, sojourn=sojourns), log_likelihood=likelihood,
        parameters=parameters, slots=len(now), low=reached[at] - chance[at], high=np.minimum(reached[at], 1.0),
        intervals=intervals, counts=counts, ages=kinds,
    )  # fmt: skip


def _sojourn(stays: NDArray[np.int64]) -> tuple[dict[str, Any], Array, float, int]:
    """Best law of sojourn times by BIC: its table, Pr(h = 1, 2, ...), log-likelihood, number of parameters."""
    n, longest = len(stays), int(stays.max())
    seen = np.bincount(stays, minlength=longest + 1)[1:].astype(np.float64)
    lengths = np.arange(1, longest + 1)
    share = seen / n
    found: list[tuple[float, dict[str, Any], Array, float, int]] = []

    def add(spec: dict[str, Any], probabilities: Array, free: int) -> None:
        with np.errstate(divide="ignore"):
            value = float((seen * np.log(np.where(seen > 0, probabilities, 1.0))).sum())
        if np.isfinite(value):
            found.append((bic(value, free, n), spec, probabilities, value, free))

    p = 1.0 / float(stays.mean())
    add({"law": "geometric", "p": p}, np.asarray(p * (1.0 - p) ** (lengths - 1), dtype=np.float64), 1)
    low = int(stays.min())
    if longest > low:
        add({"law": "uniform", "low": low, "high": longest}, np.where(lengths >= low, 1.0 / (longest - low + 1), 0.0), 2)
        weibull = _discrete_weibull(seen, lengths)
        add({"law": "discrete-weibull", "q": weibull[0], "beta": weibull[1]}, weibull_shares(*weibull, lengths), 2)
    table = share.copy()
    table[int(table.argmax())] += 1.0 - table.sum()
    add({"law": "table", "probabilities": [float(v) for v in table]}, share, int((seen > 0).sum()) - 1)
    _, spec, probabilities, value, free = min(found, key=lambda f: f[0])
    return spec, np.asarray(probabilities, dtype=np.float64), value, free


def weibull_shares(q: float, beta: float, lengths: NDArray[np.int64]) -> Array:
    """Return Pr(h = n) = q^((n-1)^beta) - q^(n^beta) (Nakagawa and Osaki 1975)."""
    n = lengths.astype(np.float64)
    return np.asarray(q ** ((n - 1.0) ** beta) - q ** (n**beta), dtype=np.float64)


def _discrete_weibull(seen: Array, lengths: NDArray[np.int64]) -> tuple[float, float]:
    def cost(free: Array) -> float:
        share = weibull_shares(float(special.expit(free[0])), float(np.exp(free[1])), lengths)
        return -float((seen * np.log(np.maximum(share, 1e-300))).sum())

    mean = float(seen @ lengths / seen.sum())
    start = np.array([special.logit(min(0.999, max(0.001, 1.0 - 1.0 / mean))), 0.0])
    found = optimize.minimize(cost, start, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-6, "maxiter": 2000})
    return float(special.expit(found.x[0])), float(np.exp(found.x[1]))
