r"""From which states a signal of a jump-linear system stays within its limits, and with what probability.

    x(k+1) = A_i x(k) + sum_q E_i^q e_q(k),    u(k) = U_i x(k) + (what adds to it, at most D),    |e_q(k)| <= 1

whatever e(k) knows of the modes and states up to slot k. Let M_0 = (U^l x)^d, d even, and

    M_{t+1, i}(x) = sum_j p_ij M_{t, j}(A_i x)

By Minkowski's inequality in the mean of the power d

    (E |u_l(k)|^d)^(1/d) <= f(k) + b,    f(k)^d = max_i M_{k, i}(x(0))
    b = D_l + sum_q sum_{t < k} max_i (sum_j p_ij M_{t, j}(E_i^q))^(1/d)

and by Markov's, P(|u_l(k)| > limit_l for a k < K) <= sum_k ((f(k) + b) / limit_l)^d. Where nothing pushes, what comes after K
slots is at most the rest of the sum of second moments, so that the bound holds for ever. While no signal leaves, the loop is
the linear one: the bound is one of the loop with limits, too. A larger d gives a larger region, as far as moments of that degree
stay finite; as d grows, b becomes what pushes can do at most.

f is a norm of x(0), so that {x(0): bound <= p} is convex and symmetric for every d.

Where a loop ends that bounded signals push, `ultimate_bound` says.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from msgspec import Struct

from design.errors import NotStable
from design.jump_linear.higher_moments import at, count, power_of_row, powers
from design.jump_linear.second_moment import Array, backward, cost_once, expect, like_units

DEGREES = (2, 4, 6, 8, 10)
MOST_PRODUCTS = 6_500_000
"""Multiplications of a slot, up to which a degree is looked at: a second or two for 1000 slots."""
SLOTS = 1000
"""Slots that are looked at one by one; where the loop is pushed, those over which the bound holds."""
ROUNDING = 1e-12
"""Share of the sizes of a form's terms that their sum may be wrong by."""
ALL = 1e-9
"""Share by which every direction of the state counts in that sum: a sum that is positive then shows that the loop is stable."""
SPARSE = 0.1
"""Share of entries that are not 0, up to which products with them alone are faster."""
FARTHEST = 1e30
"""A state that no signal sees may be as far away."""
TOGETHER = 100
"""Slots whose forms are kept at a time."""
ENDED = 1e-12
"""Share of the sum of all second moments, after which no slot is looked at on its own."""


class Leaving(Struct, frozen=True, kw_only=True):
    """What bounds the probability that u leaves its limits, by where the loop begins: x(0) = S y for one S of several.

    Args:
        degrees: d of every row below.
        free: by degree, coefficients of (E (u_l(k) / limit_l)^d) in the monomials of y, (K, m, s N, count(k, d)).
        pushed: by degree, b as a share of the limits, (m,).
        rest: second moments of u / limit after the last slot, (s N, k, k); zero where the loop is pushed.
        slots: over which the bound holds; None: for ever.
    """

    degrees: tuple[int, ...]
    free: tuple[Array, ...]
    pushed: tuple[Array, ...]
    rest: Array
    slots: int | None

    def probability(self, *starts: tuple[Sequence[int], Array], degree: int | None = None, left: float = 1.0) -> float:
        """Return the bound of the probability of leaving, at most 1.

        Args:
            starts: slots, up to that of `leaving`, and y of what is added to the state in each, whatever the mode; responses add.
            degree: the one that is used; default: the best one in every slot.
            left: share of the limits that something else leaves, above 0.
        """
        bounds = []
        for d, free, pushed in zip(self.degrees, self.free, self.pushed):
            if degree in (None, d):
                size = np.zeros(free.shape[:2])
                for slots, y in starts:
                    response = _value(free, at(y, d)).max(axis=2) ** (1.0 / d)
                    for k in slots:
                        size[k:] += response[: len(free) - k]
                bounds.append((((size + pushed) / left) ** d).sum(axis=1))
        tail = sum(len(slots) * float(np.sqrt(max((y @ self.rest @ y).max(), 0.0))) for slots, y in starts) ** 2
        return float(min(np.min(bounds, axis=0).sum() + tail / left**2, 1.0))

    def needed(self, probability: float) -> float:
        """Return the factor by which all limits must grow for a start at rest to be inside; 0 where nothing pushes.

        Args:
            probability: of leaving, at most.
        """
        each = zip(self.degrees, self.free, self.pushed)
        return float(min((len(free) * (b**d).sum() / probability) ** (1.0 / d) for d, free, b in each))

    def radii(self, probability: float) -> tuple[int, Array]:
        """Return the degree with the largest region, and how far y may be along every axis alone, (k,); 0 where nothing is.

        What lies between these points is inside, too: sum_i |y_i| / radius_i <= 1.

        Args:
            probability: of leaving, at most.
        """
        found = [(d, self._along_axes(probability, d)) for d in self.degrees]
        return max(found, key=lambda each: float(np.prod(each[1])))

    def _along_axes(self, probability: float, degree: int) -> Array:
        size = self.rest.shape[-1]
        found = np.zeros(size)
        if self.probability(((0,), np.zeros(size)), degree=degree) > probability:
            return found
        free, pushed = next((free, b) for d, free, b in zip(self.degrees, self.free, self.pushed) if d == degree)
        for i, axis in enumerate(np.eye(size)):
            response = _value(free, at(axis, degree)).max(axis=2) ** (1.0 / degree)  # it grows with y
            tail = max(float(self.rest[:, i, i].max()), 0.0)

            def inside(far: float, response: Array = response, tail: float = tail) -> bool:
                return float(((far * response + pushed) ** degree).sum() + far**2 * tail) <= probability

            # beyond this one term alone is too much, in any unit of y
            low, high = 0.0, min(probability ** (1.0 / degree) / max(float(response.max()), 1.0 / FARTHEST), FARTHEST)
            for _ in range(40):
                middle = 0.5 * (low + high)
                low, high = (middle, high) if inside(middle) else (low, middle)
            found[i] = low
        return found


def leaving(
    A: Array, transition: Array, U: Array, S: Array, *, limits: Array, pushes: Array, adds: Array,
    slots: int = SLOTS, later: int = 0,
) -> Leaving:  # fmt: skip
    """Return what bounds the probability that u(k) = U_i x(k) leaves its limits.

    Args:
        A: (N, n, n) mode matrices of a mean-square stable system.
        transition: (N, N) transition probabilities, or upper bounds of them.
        U: (N, m, n), the signals.
        S: (s, n, k), where the loop begins: x(0) = S y with one of them.
        limits: (m,) above 0.
        pushes: (N, n, q), what signals of size 1 push in a slot; no column: nothing pushes.
        adds: (m,) what adds to u besides, at most.
        slots: looked at one by one, at most.
        later: slot up to which more may be added to the state, below `slots`.

    Raises:
        NotStable: so near the edge that the sum of second moments was not found.
    """
    N, n, _ = A.shape
    scaled = U / limits[:, None]
    still = not pushes.any()
    weight = scaled.transpose(0, 2, 1) @ scaled
    total = cost_once(A, transition, weight + ALL * float(np.abs(weight).max()) * np.eye(n))  # below it only where it is stable
    if not np.isfinite(total).all() or not float(np.linalg.eigvalsh(total).min()) > 0.0:
        if (unit := like_units(A)) is None:
            raise NotStable("no region was found: the loop is too near to one that is not mean-square stable")
        return leaving(
            A * unit / unit[:, None], transition, U * unit, S / unit[:, None], limits=limits, pushes=pushes / unit[:, None],
            adds=adds, slots=slots, later=later,
        )  # fmt: skip
    begun = np.repeat(S, N, axis=0)

    def seen(family: Array) -> Array:
        return np.asarray(begun.transpose(0, 2, 1) @ np.tile(family, (len(S), 1, 1)) @ begun)

    rest, first = total, max(float(np.abs(seen(total)).max()), 1e-300)
    if still:  # as many slots as matter
        for last in range(slots):
            if float(np.abs(seen(rest)).max()) <= ENDED * first:
                slots = last + later
                break
            rest = backward(A, transition, rest)
    kept = [d for d in DEGREES if N * count(n, d) ** 2 <= MOST_PRODUCTS or d == 2]
    with np.errstate(over="ignore", invalid="ignore"):
        moves, starts = ([*zip(*(powers(each, *kept) for each in matrices))] for matrices in (A, S))
        every = [
            (d, *_of_degree(move, start, transition, scaled, pushes, d, max(slots, 1)))
            for d, move, start in zip(kept, moves, starts)
        ]
    found = [each for each in every if np.isfinite(each[1]).all() and np.isfinite(each[2]).all()]  # a power may be too large
    if not found:
        raise NotStable("no region was found: its moments leave the range of floating point")
    ended = seen(rest) if still else 0.0 * seen(rest)
    return Leaving(
        degrees=tuple(d for d, *_ in found), free=tuple(free for _, free, _ in found),
        pushed=tuple(b + adds / limits for *_, b in found),
        rest=ended, slots=None if still else slots,
    )  # fmt: skip


def _of_degree(
    moves: Sequence[Any], starts: Sequence[Any], transition: Array, U: Array, pushes: Array, degree: int, slots: int
) -> tuple[Array, Array]:
    """(E u_l(k)^d) in the monomials of y, (K, m, s N, count), and what all pushes add up to, (m,)."""
    from scipy.sparse import vstack  # where a command has no limits, it is not needed

    N, m = U.shape[:2]
    move, begins = _all_modes([each.T for each in moves]), len(starts)
    start = vstack([each.T for each in starts], format="csr")  # (s count(k), count)
    M = np.array([[power_of_row(row, degree) for row in rows] for rows in U]).transpose(0, 2, 1)  # (N, count, m)
    z = np.array([at(each, degree).T for each in pushes], order="C")  # (N, q, count)
    sizes, total = np.abs(z), np.zeros(m)
    free = np.empty((slots, m, begins * N, start.shape[0] // begins))
    for first in range(0, slots, TOGETHER):
        seen, means = np.empty((2, min(TOGETHER, slots - first), *M.shape))
        for forms, mean in zip(seen, means):
            forms[:] = M
            np.matmul(transition, M.reshape(N, -1), out=mean.reshape(N, -1))
            M = move(mean)
        begun = start @ seen.transpose(2, 0, 3, 1).reshape(M.shape[1], -1)
        free[first : first + len(seen)] = begun.reshape(begins, -1, len(seen), m, N).transpose(2, 3, 0, 4, 1).reshape(
            len(seen), m, begins * N, -1
        )  # fmt: skip
        if z.size:
            columns = np.ascontiguousarray(means.transpose(1, 2, 0, 3)).reshape(N, M.shape[1], -1)
            moved = np.maximum(z @ columns, 0.0) + ROUNDING * (sizes @ np.abs(columns))
            total += (moved.max(axis=0) ** (1.0 / degree)).sum(axis=0).reshape(-1, m).sum(axis=0)
    return free, total


def _all_modes(turned: list[Any]) -> Callable[[Array], Array]:
    """Return what takes forms (N, count, m) by their modes' matrices: by the entries alone where most are 0."""
    if sum(each.nnz for each in turned) > SPARSE * sum(each.shape[0] ** 2 for each in turned):
        full = np.stack([each.toarray() for each in turned])
        return lambda forms: np.asarray(full @ forms)
    from scipy.sparse import block_diag

    blocks = block_diag(turned, format="csr")
    return lambda forms: np.asarray(blocks @ forms.reshape(-1, forms.shape[2])).reshape(forms.shape)


def _value(forms: Array, z: Array) -> Array:
    """Values of forms (..., count) at monomials (count,), rounding on the safe side, never below 0."""
    value, size = (np.einsum("...c,c->...", *each) for each in ((forms, z), (np.abs(forms), np.abs(z))))
    return np.asarray(np.maximum(value, 0.0) + ROUNDING * size)


SHARE = 1e-3
"""What of a bound may be left to the end of its sum."""
TERMS = 100_000


def ultimate_bound(A: Array, transition: Array, E: Array, C: Array) -> Array:
    r"""Return what the root mean square of C x ends within, the share of each signal, (q,); their sum is the bound.

    It holds for a stable system, whatever the bounded signals are that push it.

    .. math:: x(k+1) = A_i x(k) + \sum_q E_i^q e_q(k), \qquad |e_q(k)| \le 1, \qquad z = C x

    By Minkowski's inequality in the mean square, with M_0 = C'C and M_{t+1} = L M_t, the cost operator of `second_moment`,

    .. math:: \limsup_k \sqrt{E |z(k)|^2} \le \sum_q \sum_t \sqrt{\max_i E_i^{q\prime} (\textstyle\sum_j p_{ij} M_t^j) E_i^q}

    whatever e(k) knows of the modes and states up to slot k. The sum over t is ended where what follows is known to be small:
    with P - L P >= I, L P <= (1 - 1/|P|) P.

    Args:
        A: (N, n, n) mode matrices of a mean-square stable system.
        transition: (N, N) transition probabilities, or upper bounds of them over which it is stable.
        E: (N, n, q), what signals of size 1 push.
        C: (l, n), what is asked for.

    Raises:
        NotStable: so near the edge that no bound was found.
    """
    P = cost_once(A, transition, np.broadcast_to(np.eye(A.shape[-1]), A.shape))
    largest = float(np.linalg.eigvalsh(P)[:, -1].max())
    if not 1.0 <= largest < 1e14 or float(np.linalg.eigvalsh(P)[:, 0].min()) < 1.0 - 1e-6:
        if (unit := like_units(A)) is None:
            raise NotStable("no bound was found: the loop is too near to one that is not mean-square stable")
        return ultimate_bound(A * unit / unit[:, None], transition, E / unit[:, None], C * unit)
    left = np.sqrt(_reached(expect(transition, P), E)) / (1.0 - np.sqrt(max(1.0 - 1.0 / largest, 0.0)))
    M, total = np.broadcast_to(C.T @ C, A.shape), np.zeros(E.shape[-1])
    for _ in range(TERMS):
        total = total + np.sqrt(_reached(expect(transition, M), E))
        M = backward(A, transition, M)
        tail = np.sqrt(max(float(np.linalg.eigvalsh(M)[:, -1].max()), 0.0)) * left
        if (tail <= SHARE * total).all():
            return np.asarray(total + tail)
    raise NotStable("no bound was found: the loop is too near to one that is not mean-square stable")


def _reached(M: Array, E: Array) -> Array:
    """max_i E_i^q' M_i E_i^q, (q,)."""
    return np.asarray(np.maximum(np.einsum("iaq,iab,ibq->iq", E, M, E), 0.0).max(axis=0))
