r"""Where a loop around an integrator ends whose input saturates: from anywhere, and in every order of its delays.

    x(k+1) = A x(k) + B sat(u(k)) + sum_q E_q e_q(k),    |e_q(k)| <= 1,    |sat(u)| = min(|u|, L)
    u(k) = K(k) (C x(k - delta(k)) + f(k)),    0 <= delta(k) <= Delta,    |f(k)| <= F,    K(k) in [K_low, K_high]

A has one simple eigenvalue 1, with A v = v, l A = l, C v = l v = 1, and is stable beside it. Then z = l x is a pure integrator,

    z(k+1) = z(k) + b sat(u(k)) + w(k),    b = l B,    |w(k)| <= W = sum_q |l E_q|,    |z(k+1) - z(k)| <= M = |b| L + W

and C x = z + C (I - v l) x, where the second part is a stable response to bounded signals: it ends within H. So

    |C x(k - delta) + f - z(k)| <= H + Delta M + F

in the end. Where b K < 0 for every gain and W < |b| L, z comes nearer to 0 in every slot, by an amount that does not vanish, as
long as |z| > D for a D > H + Delta M + F + W / (|b| K_low): the delayed sample has the sign of z, and the command that it asks
for is stronger than what pushes. It passes D by one slot's motion M at most: in the end |z| <= D + M.

A signal r x is a filter of z beside what pushes, as b sat(u(k)) = z(k+1) - z(k) - w(k): with h_j = r (I - v l) (A (I - v l))^j B,

    |r x| <= (|r v + h_0 / b| + sum_j |h_{j+1} - h_j| / |b|) (D + M) + sum_q sum_j |r (I - v l) A^j (E_q - B l E_q / b)|

in the end, and, as z, by its own response to what moves it; the smaller one is the bound.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.errors import DesignError

Array = npt.NDArray[np.float64]
EQUAL = 1e-9
"""An eigenvalue as near to 1 counts as an integrator's."""
SETTLED = 1e-3
"""Row sum of |S^J| up to which J slots of a stable part are summed one by one."""
MOST_SLOTS = 20_000


class Ends(NamedTuple):
    """Where the loop ends, whatever the order of its delays.

    Attributes:
        share: W / (|b| L), what pushes as a share of what the limited command moves; below 1.
        states: bound of every |x_i|, (n,).
        output: bound of |C x|.
    """

    share: float
    states: Array
    output: float


def ends_in_every_order(
    A: Array, B: Array, C: Array, *, limit: float, gains: Array, delay: int, pushes: Array, adds: float
) -> Ends:  # fmt: skip
    """Return where a saturating loop around an integrator ends.

    Args:
        A, B, C: (n, n), (n, 1), (1, n), the plant at the sample period.
        limit: L, largest command that acts.
        gains: every gain that may act, of one sign.
        delay: Delta, largest age of the sample behind a command that acts, in slots.
        pushes: (n, q), what signals of size 1 move the state by in a slot.
        adds: F, largest error of a sample.

    Raises:
        DesignError: the plant is no single integrator beside a stable part, the gains do not lead back to 0, or what pushes is as
            strong as the command; in words.
    """
    n = len(A)
    l, v = _integrator(A, C)
    b, W = float(l @ B[:, 0]), float(np.abs(l @ pushes).sum())
    if not gains.size or not (b * gains < 0.0).all():
        raise DesignError("not every gain leads the integrator back")
    if not abs(b) * limit > W:
        raise DesignError("what departs is as strong as the limited command")
    M = abs(b) * limit + W
    aside, rows = np.eye(n) - np.outer(v, l), np.vstack([C, np.eye(n)])
    S, moved = aside @ A, aside @ np.hstack([limit * B, pushes])
    rest = _sums(S, moved, rows)
    D = rest[0] + delay * M + adds + W / (abs(b) * float(np.abs(gains).min()))
    by_itself = np.abs(rows @ v) * (D + M) + rest
    filtered = np.abs(rows @ (v + aside @ B[:, 0] / b)) + _sums(S, aside @ B, rows @ (S - np.eye(n))) / abs(b)
    by_filter = filtered * (D + M) + _sums(S, aside @ (pushes - np.outer(B[:, 0], l @ pushes) / b), rows)
    bounds = np.minimum(by_itself, by_filter)
    return Ends(W / (abs(b) * limit), bounds[1:], float(bounds[0]))


def _integrator(A: Array, C: Array) -> tuple[Array, Array]:
    """l and v of the simple eigenvalue 1."""
    left, sizes, right = np.linalg.svd(A - np.eye(len(A)))
    if sizes[-1] > EQUAL * max(sizes[0], 1.0):
        raise DesignError("the plant does not integrate")
    v, l = right[-1], left[:, -1]
    seen, kept = float(C[0] @ v), float(l @ v)
    if abs(seen) <= EQUAL or abs(kept) <= EQUAL:
        raise DesignError("the plant integrates more than once, or its output does not show it")
    v = v / seen
    return l / float(l @ v), v


def _sums(S: Array, G: Array, R: Array) -> Array:
    """A bound of sum_j sum_q |R S^j G|, one entry per row of R, S stable on the columns of G."""
    total, known, power, response = np.zeros(len(R)), np.zeros(len(S)), np.eye(len(S)), G
    for _ in range(MOST_SLOTS):
        total += np.abs(R @ response).sum(axis=1)
        known += np.abs(response).sum(axis=1)
        power, response = S @ power, S @ response
        if (left := float(np.abs(power).sum(axis=1).max())) <= SETTLED:
            # the slots that follow repeat those before, through |S^J|: at most |S^J| (I - |S^J|)^-1 of them
            tail = np.abs(power).sum(axis=1) * known.max() / (1.0 - left)
            return np.asarray(total + np.abs(R) @ tail)
    raise DesignError("beside the integrator the plant is not stable, or too slow")
