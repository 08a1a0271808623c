"""Loss by likelihood: none, independent, or a channel of two modes (Gilbert 1960, Elliott 1963, Bell System Technical Journal).

    l(theta) = log nu B(x_0) P B(x_1) P ... 1,    B(lost) = diag(loss_good, loss_bad),  B(came) = I - B(lost)

The product of 2 x 2 matrices is taken eight packets at a time: there are 256 such products.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special, stats

from transport.law_fit.latency_families import bic
from transport.law_fit.proportions import Interval, wald_logit, wilson

Array = NDArray[np.float64]
Lost = NDArray[np.bool_]

ALL = ("p_gb", "p_bg", "loss_good", "loss_bad")
STARTS = ((0.25, 0.7, 1.0), (0.2, 0.8, 0.6), (0.4, 0.6, 0.5))
"""Where the search begins, as the likelihood has several tops: loss in the good mode as a share of all, in the bad one, and how
much longer than they look the stays are."""
AT_AN_END = 8.0
"""A logit beyond this is at its end: the good mode then loses nothing, or the bad one all, and it is estimated no more."""

NEARLY = 0.15
"""An end of an interval that is nearer to 0 (or 1) than this share of the estimate is 0 (or 1): the logit knows no end."""
SUSPECT = 0.01
FEWEST_LOSSES = 10
"""Of fewer losses no channel is estimated."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LossFit:
    """A law of losses.

    Attributes:
        kind: "none", "independent" or "gilbert-elliott".
        values: of the parameters: `loss`, or p_gb, p_bg, loss_good, loss_bad.
        intervals: with 95 % confidence, of those that were estimated.
        log_likelihood, parameters: of it.
        predicted: (n,) Pr(the packet is lost | what became of those before it).
    """

    kind: str
    values: dict[str, float]
    intervals: dict[str, Interval]
    log_likelihood: float
    parameters: int
    predicted: Array

    def spec(self) -> float | dict[str, float]:
        """Return the field `loss` of a packet law."""
        return self.values["loss"] if "loss" in self.values else dict(self.values)


def fit_loss(lost: Lost, *, whole: bool) -> list[LossFit]:
    """Return the fits, the best by BIC first.

    Args:
        lost: (n,) which packets did not come.
        whole: every packet that did not come was lost, none overtaken; otherwise no channel is tried.
    """
    n, losses = len(lost), int(lost.sum())
    if not losses:
        none = {"loss": wilson(0, n)}
        return [
            LossFit(kind="none", values={"loss": 0.0}, intervals=none, log_likelihood=0.0, parameters=0, predicted=np.zeros(n))
        ]
    p = losses / n
    found = [LossFit(
        kind="independent", values={"loss": p}, intervals={"loss": wilson(losses, n)}, parameters=1, predicted=np.full(n, p),
        log_likelihood=losses * np.log(p) + (n - losses) * np.log1p(-p) if p < 1.0 else 0.0,
    )]  # fmt: skip
    if whole and losses >= FEWEST_LOSSES and _in_bursts(lost):
        likelihood = _likelihood_of(lost)
        fit = _channel(lost, ALL, likelihood)
        found += [] if fit is None else [fit]
    return sorted(found, key=lambda f: bic(f.log_likelihood, f.parameters, n))


def _in_bursts(lost: Lost) -> bool:
    """Whether a loss makes one of the next two packets more likely to be lost (Fisher's exact test, one-sided)."""
    for lag in (1, 2):
        now, then = lost[:-lag], lost[lag:]
        pairs = np.array([[(a & b).sum() for b in (then, ~then)] for a in (now, ~now)])
        if stats.fisher_exact(pairs, alternative="greater").pvalue < SUSPECT:
            return True
    return False


def _all(free: Array, names: tuple[str, ...]) -> Array:
    """(4,) p_gb, p_bg, loss_good, loss_bad from the logits of those that are estimated."""
    full = {"p_gb": 0.0, "p_bg": 0.0, "loss_good": 0.0, "loss_bad": 1.0} | dict(zip(names, special.expit(free).tolist()))
    return np.array(list(full.values()))


def _channel(lost: Lost, names: tuple[str, ...], likelihood: Callable[[Array], float]) -> LossFit | None:
    n, p = len(lost), float(lost.mean())
    again = float((lost[1:] & lost[:-1]).sum() / max(1, lost[:-1].sum()))  # Pr(lost | the one before was)
    leave = min(0.9, max(1e-3, 1.0 - again))
    start = {"p_gb": min(0.5, max(2.0 / n, p * leave / (1.0 - p))), "p_bg": leave}

    def cost(free: Array) -> float:
        return -likelihood(_all(free, names)) if np.abs(free).max() < 30.0 else 1e300

    tried = []
    for good, bad, rate in STARTS:
        all_of_them = {name: rate * value for name, value in start.items()} | {"loss_good": p * good, "loss_bad": bad}
        begin = special.logit([min(0.95, all_of_them[name]) for name in names])
        found = optimize.minimize(cost, begin, method="Nelder-Mead", options={"xatol": 1e-2, "fatol": 1e-2, "maxiter": 400})
        tried.append(optimize.minimize(cost, found.x, method="BFGS", options={"gtol": 1e-3}))
    best = min(tried, key=lambda each: float(each.fun))
    ends = {name for name, x in zip(names, best.x.tolist()) if (x < -AT_AN_END if name == "loss_good" else x > AT_AN_END)}
    if ends & {"loss_good", "loss_bad"}:
        return _channel(lost, tuple(name for name in names if name not in ends or name.startswith("p_")), likelihood)
    values = _all(best.x, names)
    if values[2] > values[3]:
        return None
    intervals = wald_logit(cost, best.x, names)
    if "loss_good" in intervals and intervals["loss_good"].low < NEARLY * values[2]:
        intervals["loss_good"] = Interval(0.0, intervals["loss_good"].high)
    if "loss_bad" in intervals and 1.0 - intervals["loss_bad"].high < NEARLY * (1.0 - values[3]):
        intervals["loss_bad"] = Interval(intervals["loss_bad"].low, 1.0)
    return LossFit(
        kind="gilbert-elliott", values=dict(zip(("p_gb", "p_bg", "loss_good", "loss_bad"), values.tolist())), intervals=intervals,
        log_likelihood=-float(best.fun), parameters=len(names), predicted=_predicted(lost, values),
    )  # fmt: skip


def _matrices(values: Array) -> tuple[Array, Array]:
    """Stationary row (2,), and (2, 2, 2): for came and lost, emission and then transition."""
    p_gb, p_bg, good, bad = values.tolist()
    transition = np.array([[1.0 - p_gb, p_gb], [p_bg, 1.0 - p_bg]])
    emission = np.array([[1.0 - good, 1.0 - bad], [good, bad]])
    return np.array([p_bg, p_gb]) / (p_gb + p_bg), emission[:, :, None] * transition[None]


def _likelihood_of(lost: Lost) -> Callable[[Array], float]:
    """Return the log-likelihood as a function of (p_gb, p_bg, loss_good, loss_bad)."""
    blocks = len(lost) // 8
    codes = np.packbits(lost[: 8 * blocks].reshape(blocks, 8), axis=1)[:, 0]
    rest = lost[8 * blocks :].astype(np.int64)

    def likelihood(values: Array) -> float:
        first, steps = _matrices(values)
        eights = steps
        for _ in range(3):  # two, four, eight packets
            size = len(eights)
            eights = (eights[:, None] @ eights[None]).reshape(size * size, 2, 2)
        product, logarithm = eights[codes], 0.0
        while len(product) > 1:
            half = len(product) // 2
            tail = product[2 * half :]
            product = product[0 : 2 * half : 2] @ product[1 : 2 * half : 2]
            sums = product.sum(axis=(1, 2))
            if (sums <= 0.0).any():
                return -1e300
            logarithm += float(np.log(sums).sum())
            product = np.concatenate([product / sums[:, None, None], tail])
        row = first @ product[0] if blocks else first
        for symbol in rest.tolist():
            row = row @ steps[symbol]
        total = float(row.sum())
        return logarithm + float(np.log(total)) if total > 0.0 else -1e300

    return likelihood


def _predicted(lost: Lost, values: Array) -> Array:
    p_gb, p_bg, good, bad = values.tolist()
    found, in_bad = np.empty(len(lost)), p_gb / (p_gb + p_bg)
    for k, gone in enumerate(lost.tolist()):
        p = found[k] = (1.0 - in_bad) * good + in_bad * bad
        after = in_bad * bad / p if gone and p > 0.0 else in_bad * (1.0 - bad) / (1.0 - p) if p < 1.0 else in_bad
        in_bad = (1.0 - after) * p_gb + after * (1.0 - p_bg)
    return found
