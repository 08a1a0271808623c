"""Loss by likelihood: none, independent, or a channel of two modes (Gilbert 1960, Elliott 1963, Bell System Technical Journal).

    l(theta) = log nu B(x_0) P B(x_1) P ... 1,    B(lost) = diag(loss_good, loss_bad),  B(came) = I - B(lost)

The product of 2 x 2 matrices is taken eight packets at a time: there are 256 such products.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from transport.law_fit.latency_families import bic
from transport.law_fit.packet_record import Array
from transport.law_fit.profile_intervals import angles_of, minimum, profile_intervals, values_of
from transport.law_fit.proportions import Interval, interval_of

Lost = NDArray[np.bool_]

ALL = ("p_gb", "p_bg", "loss_good", "loss_bad")
STARTS = ((0.25, 0.7, 1.0), (0.2, 0.8, 0.6), (0.4, 0.6, 0.5))
"""Where the search begins, as the likelihood has several tops: loss in the good mode as a share of all, in the bad one, and how
much longer than they look the stays are."""
SEARCHED = 1e-3
"""A mode that loses nothing, or all, is taken where the likelihood is no smaller there, as far as the search shows."""

IMPOSSIBLE = 1e300
AT_ONCE = 1 << 14
"""Blocks of eight packets whose matrices are multiplied at once, about: these stay in a cache."""
LANES = 64
"""Pieces of the record whose products are taken side by side, so that numbers that meet lie side by side."""
ONE = 256
"""Code of the unit matrix, which fills the last piece."""
SUSPECT = 0.01
FEWEST_LOSSES = 10
"""Of fewer losses no channel is estimated."""


class LossFit(Struct, frozen=True, kw_only=True, eq=False):
    """A law of losses.

    Attributes:
        kind: "none", "independent" or "gilbert-elliott".
        values: of the parameters: `loss`, or p_gb, p_bg, loss_good, loss_bad.
        intervals: with 95 % confidence, of all of them, also of one whose estimate is at an end.
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
        none = {"loss": interval_of(0, n)}
        return [
            LossFit(kind="none", values={"loss": 0.0}, intervals=none, log_likelihood=0.0, parameters=0, predicted=np.zeros(n))
        ]
    p = losses / n
    found = [LossFit(
        kind="independent", values={"loss": p}, intervals={"loss": interval_of(losses, n)}, parameters=1, predicted=np.full(n, p),
        log_likelihood=losses * np.log(p) + (n - losses) * np.log1p(-p) if p < 1.0 else 0.0,
    )]  # fmt: skip
    if whole and losses >= FEWEST_LOSSES and _in_bursts(lost):
        found.append(_channel(lost, _likelihood_of(lost)))
    return sorted(found, key=lambda f: bic(f.log_likelihood, f.parameters, n))


def _in_bursts(lost: Lost) -> bool:
    """Whether a loss makes one of the next two packets more likely to be lost (Fisher's exact test, one-sided)."""
    from scipy import stats  # half a second of CPU

    for lag in (1, 2):
        now, then = lost[:-lag], lost[lag:]
        pairs = np.array([[(a & b).sum() for b in (then, ~then)] for a in (now, ~now)])
        if stats.fisher_exact(pairs, alternative="greater").pvalue < SUSPECT:
            return True
    return False


def _channel(lost: Lost, likelihood: Callable[[Array], Array]) -> LossFit:
    p = float(lost.mean())
    again = float((lost[1:] & lost[:-1]).sum() / max(1, lost[:-1].sum()))  # Pr(lost | the one before was)
    leave = min(0.9, max(1e-3, 1.0 - again))
    enter = min(0.5, p * leave / (1.0 - p))

    def cost(angles: Array) -> Array:
        return -likelihood(values_of(angles))

    begins = (np.array([rate * enter, rate * leave, p * good, bad]) for good, bad, rate in STARTS)
    at, least = min((minimum(cost, angles_of(np.minimum(begin, 0.97))) for begin in begins), key=lambda each: each[1])
    values, free = values_of(at), len(ALL)
    if values[2] > values[3]:
        values = values[[1, 0, 3, 2]]  # the modes have no names of their own
    for number, end in ((2, 0.0), (3, 1.0)):
        there = np.where(np.arange(len(ALL)) == number, end, values)
        found, value = _rest(cost, angles_of(there), number)
        if value <= least + SEARCHED:
            values, least, free = values_of(found), min(least, value), free - 1
    found = angles_of(values)
    return LossFit(
        kind="gilbert-elliott", values=dict(zip(ALL, values.tolist())), log_likelihood=-least, parameters=free,
        intervals=dict(zip(ALL, profile_intervals(cost, found))), predicted=_predicted(lost, values),
    )  # fmt: skip


def _rest(cost: Callable[[Array], Array], at: Array, held: int) -> tuple[Array, float]:
    """All angles, and the cost, where it is least with one of them held."""
    found, value = minimum(lambda x: cost(np.insert(x, held, at[held], axis=1)), np.delete(at, held))
    return np.insert(found, held, at[held]), value


def _matrices(values: Array) -> tuple[Array, Array]:
    """Stationary rows (b, 2), and (2, 2, b, 2): entries, then came and lost, of emission and then transition."""
    p_gb, p_bg, good, bad = values.T
    transition = np.array([[1.0 - p_gb, p_gb], [p_bg, 1.0 - p_bg]])
    emission = np.array([[1.0 - good, good], [1.0 - bad, bad]])  # (mode, symbol, b)
    return np.stack([p_bg, p_gb], axis=1) / (p_gb + p_bg)[:, None], np.einsum("isb,ijb->ijbs", emission, transition)


def _product(left: Array, right: Array) -> Array:
    """(2, 2, ...) entry by entry."""
    found = left[:, :1] * right[:1]
    found += left[:, 1:] * right[1:]
    return found


def _ordered(factors: Array) -> tuple[Array, Array]:
    """Product of (2, 2, b, k, lanes) along k, each scaled to the sum 1, and (b,) the logarithm of what was taken out."""
    logarithm = np.zeros(factors.shape[2])
    while factors.shape[3] > 1:
        even = factors.shape[3] // 2 * 2
        found = _product(factors[:, :, :, 0:even:2], factors[:, :, :, 1:even:2])
        sums = found.sum(axis=(0, 1))
        logarithm += np.log(sums).sum(axis=(1, 2))
        found /= sums
        factors = np.concatenate([found, factors[:, :, :, even:]], axis=3) if even < factors.shape[3] else found
    return factors[:, :, :, 0], logarithm


def _likelihood_of(lost: Lost) -> Callable[[Array], Array]:
    """Return the log-likelihood as a function of rows (b, 4) of p_gb, p_bg, loss_good, loss_bad; (b,)."""
    blocks = len(lost) // 8
    codes = np.packbits(lost[: 8 * blocks].reshape(blocks, 8), axis=1)[:, 0].astype(np.intp)
    codes = np.append(codes, np.full(-blocks % LANES, ONE)).reshape(LANES, -1).T.copy()
    rest = lost[8 * blocks :].astype(np.int64)
    together = max(1, AT_ONCE // codes.size)
    one = np.eye(2)[:, :, None, None]

    def likelihood(values: Array) -> Array:
        return np.concatenate([of_rows(values[i : i + together]) for i in range(0, len(values), together)])

    def of_rows(values: Array) -> Array:
        first, steps = _matrices(values)
        eights = steps
        for _ in range(3):  # two, four, eight packets
            eights = _product(eights[..., :, None], eights[..., None, :]).reshape(2, 2, len(values), -1)
        eights = np.concatenate([eights, np.broadcast_to(one, (2, 2, len(values), 1))], axis=3)
        with np.errstate(divide="ignore", invalid="ignore"):
            lanes, inner = _ordered(np.take(eights, codes, axis=3))
            product, outer = _ordered(lanes[..., None])
            row = np.einsum("bi,ijb->bj", first, product[..., 0])
            for symbol in rest.tolist():
                row = np.einsum("bi,ijb->bj", row, steps[..., symbol])
            total = inner + outer + np.log(row.sum(axis=1))
        return np.where(np.isfinite(total), total, -IMPOSSIBLE)

    return likelihood


def _predicted(lost: Lost, values: Array) -> Array:
    p_gb, p_bg, good, bad = values.tolist()
    found, in_bad = np.empty(len(lost)), p_gb / (p_gb + p_bg)
    for k, gone in enumerate(lost.tolist()):
        p = found[k] = (1.0 - in_bad) * good + in_bad * bad
        after = in_bad * bad / p if gone and p > 0.0 else in_bad * (1.0 - bad) / (1.0 - p) if p < 1.0 else in_bad
        in_bad = (1.0 - after) * p_gb + after * (1.0 - p_bg)
    return found
