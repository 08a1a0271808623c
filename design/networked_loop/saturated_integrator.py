r"""Where a loop around an integrator ends whose input saturates, from anywhere: in every order of its delays, or in the mean.

    x(k+1) = A x(k) + B sat(u(k)) + sum_q E_q e_q(k),    |e_q(k)| <= 1,    |sat(u)| = min(|u|, L)
    u(k) = K(k) (C x(k - delta(k)) + f(k)),    0 <= delta(k) <= Delta,    |f(k)| <= F,    K(k) in [K_low, K_high]

A has one simple eigenvalue 1, with A v = v, l A = l, C v = l v = 1, and is stable beside it. Then z = l x is a pure integrator,

    z(k+1) = z(k) + b sat(u(k)) + w(k),    b = l B,    |w(k)| <= W = sum_q |l E_q|,    |z(k+1) - z(k)| <= M = |b| L + W

and C x = z + C (I - v l) x, where the second part is a stable response to bounded signals: it ends within H. So

    |C x(k - delta) + f - z(k)| <= H + Delta M + F

in the end. Where b K < 0 for every gain and W < |b| L, z comes nearer to 0 in every slot, by an amount that does not vanish, as
long as |z| > D for a D > H + Delta M + F + W / (|b| K_low): the delayed sample has the sign of z, and the command that it asks
for is stronger than what pushes. It passes D by one slot's motion M at most: in the end |z| <= D + M.

A state of the controller's own, u(k) = K e(k) + L xi(k), xi(k+1) = G xi(k) + g e(k), remembers earlier samples:

    u(k) = (K + sum_j h_j) e(k) + sum_j h_j (e(k - j) - e(k)),    h_j = L G ... G g with j - 1 factors G

so that K + sum_j h_j stands for K, whatever the order of the tables. C x moves by N in a slot at most, in the end: beside it
strays sum_j |h_j| ((Delta + j) N + 2 F). The first h_j are taken for every order, the rest in a norm in which every G shrinks.

A signal r x is a filter of z beside what pushes, as b sat(u(k)) = z(k+1) - z(k) - w(k): with h_j = r (I - v l) (A (I - v l))^j B,

    |r x| <= (|r v + h_0 / b| + sum_j |h_{j+1} - h_j| / |b|) (D + M) + sum_q sum_j |r (I - v l) A^j (E_q - B l E_q / b)|

in the end, and, as z, by its own response to what moves it; the smaller one is the bound.

Where a few gains lead away, an order of delays may lead out, and the mean decides. Let i be a state of the chain that says which
gain acts, a_i = W - |b| min(L, |K_i| (D - H - Delta M - F)) where it leads back and W + |b| L where it does not. With c > 0 and
sum_j p_ij c_j exp(eta a_i) <= g c_i, g < 1, and D >= M, the function V = c_i exp(eta max(|z| - D, 0)) has

    E V(k+1) <= g V(k) + q,    q = exp(eta M) max_i sum_j p_ij c_j

so that E exp(eta max(|z| - D, 0)) <= Q = q / ((1 - g) min c) in the end, and with t = D + (1 + log Q) / eta

    P(|z| > D + s) <= Q exp(-eta s),    E z^2 <= t^2 + 1 / eta^2
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from design.errors import DesignError
from design.networked_loop import Array

EQUAL = 1e-11
"""An eigenvalue as near to 1 counts as an integrator's."""
SHOWN = 1e-9
"""Share of its terms above which a sum counts as not 0, whatever the units of the states are."""
SETTLED = 1e-3
"""Row sum of |S^J| up to which J slots of a stable part are summed one by one."""
MOST_SLOTS = 20_000
MOST_ORDERS = 20_000
"""Orders of the tables for which what a controller remembers is taken one by one."""


MOST_STATES = 200
"""States of the chain that says which gain acts, up to which a drift is looked for: a second or so."""


class Ends(NamedTuple):
    """Where the loop ends.

    Attributes:
        share: W / (|b| L), what pushes as a share of what the limited command moves; below 1.
        states: bound of every |x_i|, or of its root mean square, (n,).
        output: the same of C x.
    """

    share: float
    states: Array
    output: float


class LimitedMotion(NamedTuple):
    """What z and the rest do under a limited command.

    Attributes:
        limit: L, largest command that acts.
        b, W, M: of z, see the module.
        apart: H + Delta M + F.
        slope: N, by which C x moves in a slot at most.
        earlier: Delta N + 2 F.
        by_itself, rest: of C x and every x_i what they have of z, and beside it, (1 + n,).
        filtered, unfiltered: the same behind the filter of z.
    """

    limit: float
    b: float
    W: float
    M: float
    apart: float
    slope: float
    earlier: float
    by_itself: Array
    rest: Array
    filtered: Array
    unfiltered: Array

    def ends_in_every_order(self, gains: Array, own: Array | None = None) -> Ends:
        """Return where the loop ends, whatever the order of its delays.

        Args:
            gains: every gain that may act, of one sign; with a controller's own state by tables, (tables, rows, 1 + c).
            own: (tables, c, 1 + c), what makes that state.

        Raises:
            DesignError: the gains do not lead back to 0; in words.
        """
        if own is None:
            acts, strays, unknown = gains, np.zeros(gains.shape), np.zeros(gains.shape)
        else:
            acts, strays, unknown = self._remembered(gains, own)
        if not gains.size or not (self.b * acts + abs(self.b) * unknown < 0.0).all():
            raise DesignError("not every gain leads the integrator back")
        least = np.abs(acts) - unknown
        D = float((((least + 2.0 * unknown) * self.apart + strays + self.W / abs(self.b)) / least).max())
        return self._ends(D + self.M)

    def _remembered(self, gains: Array, own: Array) -> tuple[Array, Array, Array]:
        """Return by what a z that stays is multiplied, what strays beside it, and how far the first is not known, (orders,) each.

        Args:
            gains, own: see `ends_in_every_order`.
        """
        both = np.unique(np.concatenate([gains, own], axis=1), axis=0)
        gains, own = both[:, : gains.shape[1]], both[:, gains.shape[1] :]
        shrinks, norm = _shrinking(own[:, :, 1:])
        acts, of = gains[:, :, 0].ravel(), gains[:, :, 1:].reshape(-1, own.shape[1])
        strays, slots, seen = np.zeros(len(acts)), 0, np.linalg.inv(norm)
        made = float(np.linalg.norm(norm @ own[:, :, :1], axis=1).max()) / (1.0 - shrinks)
        while ((unknown := np.linalg.norm(of @ seen, axis=1) * made) > SHOWN * np.abs(acts)).any():
            if len(acts) * len(own) > MOST_ORDERS:
                break
            slots += 1
            more = (of @ own[:, :, 0].T).ravel()
            strays = np.repeat(strays, len(own)) + np.abs(more) * (self.earlier + slots * self.slope)
            acts, of = np.repeat(acts, len(own)) + more, np.einsum("ic,tcd->itd", of, own[:, :, 1:]).reshape(-1, own.shape[1])
        return acts, strays + unknown * (self.earlier + (slots + 1.0 / (1.0 - shrinks)) * self.slope), unknown

    def ends_in_mean(self, gains: Array, chances: Array) -> Ends:
        """Return within which root mean squares the loop ends.

        Args:
            gains: the gain that acts in each state of a chain, (N,).
            chances: its transition probabilities, or upper bounds of them, (N, N).

        Raises:
            DesignError: in the mean the gains lead away, or nothing was found; in words.
        """
        if len(gains) > MOST_STATES:
            raise DesignError(f"{len(gains)} states say which gain acts, at most {MOST_STATES}")
        limit, back, size = self.limit, self.b * gains < 0.0, np.abs(gains)
        if not back.any():
            raise DesignError("no gain leads the integrator back")
        found = np.inf
        for beyond in np.geomspace(0.1, 2.0, 14) * limit / float(size[back].max()):
            D = max(self.apart + beyond, self.M)
            drift = self.W + abs(self.b) * np.where(back, -np.minimum(limit, size * (D - self.apart)), limit)
            for eta in np.geomspace(0.02, 4.0, 16) / self.M:
                found = min(found, *(_mean_square(drift, chances, D, eta, self.M, g) for g in (0.5, 0.8, 0.9, 0.95, 0.99)))
        if not np.isfinite(found):
            raise DesignError("in the mean no drift towards 0 was found")
        return self._ends(float(np.sqrt(found)))

    def _ends(self, z: float) -> Ends:
        """Where the loop ends whose integrator ends within z."""
        each = np.minimum(self.by_itself * z + self.rest, self.filtered * z + self.unfiltered)
        return Ends(self.W / (abs(self.b) * self.limit), each[1:], float(each[0]))


def limited_motion(A: Array, B: Array, C: Array, *, limit: float, delay: int, pushes: Array, adds: float) -> LimitedMotion:
    """Return what a loop around an integrator does whose command saturates.

    Args:
        A, B, C: (n, n), (n, 1), (1, n), the plant at the sample period.
        limit: L, largest command that acts.
        delay: Delta, largest age of the sample behind a command that acts, in slots.
        pushes: (n, q), what signals of size 1 move the state by in a slot.
        adds: F, largest error of a sample.

    Raises:
        DesignError: the plant is no single integrator beside a stable part, or what pushes is as strong as the command; in words.
    """
    n = len(A)
    l, v = integrator(A, C)
    b, W = float(l @ B[:, 0]), float(np.abs(l @ pushes).sum())
    if not abs(b) * limit > W:
        raise DesignError("what departs is as strong as the limited command")
    M = abs(b) * limit + W
    aside, rows, moves = np.eye(n) - np.outer(v, l), np.vstack([C, np.eye(n)]), np.hstack([limit * B, pushes])
    S = aside @ A
    *rest, faster = _sums(S, aside @ moves, np.vstack([rows, C @ (A - np.eye(n))]))
    slope = float(faster + np.abs(C @ moves).sum())
    filtered = np.abs(rows @ (v + aside @ B[:, 0] / b)) + _sums(S, aside @ B, rows @ (S - np.eye(n))) / abs(b)
    unfiltered = _sums(S, aside @ (pushes - np.outer(B[:, 0], l @ pushes) / b), rows)
    return LimitedMotion(
        limit, b, W, M, float(rest[0]) + delay * M + adds, slope, delay * slope + 2.0 * adds, np.abs(rows @ v), np.array(rest),
        filtered, unfiltered,
    )  # fmt: skip


def _mean_square(drift: Array, chances: Array, D: float, eta: float, M: float, g: float) -> float:
    """The bound of E z^2 by one family c, inf where it does not serve."""
    c = np.linalg.solve(np.eye(len(drift)) - np.exp(eta * drift)[:, None] * chances / g, np.ones(len(drift)))
    if not c.min() > 0.0:  # with c > 0 the inverse has no entry below 0, and the family falls by g
        return np.inf
    Q = max(float(np.exp(eta * M) * (chances @ c).max() / ((1.0 - g) * c.min())), 1.0)
    return float((D + (1.0 + np.log(Q)) / eta) ** 2 + 1.0 / eta**2)


def _shrinking(G: Array) -> tuple[float, Array]:
    """Return by what every one of some matrices, (tables, c, c), shrinks |R x| at least, and R, (c, c).

    Raises:
        DesignError: no R was found; in words.
    """
    c = G.shape[-1]
    squares = np.mean([np.kron(each.T, each.T) for each in G], axis=0)
    try:
        P = np.linalg.solve(np.eye(c * c) - squares, np.eye(c).ravel()).reshape(c, c)
        R = np.asarray(np.linalg.cholesky(0.5 * (P + P.T)).T, dtype=np.float64)
    except np.linalg.LinAlgError:
        raise DesignError("the controller's own state may grow") from None
    shrinks = float(np.linalg.norm(R @ G @ np.linalg.inv(R), 2, axis=(1, 2)).max())
    if not shrinks < 1.0:
        raise DesignError("no norm was found in which the controller's own state shrinks in every order")
    return shrinks, R


def integrator(A: Array, C: Array) -> tuple[Array, Array]:
    """Return l and v of the simple eigenvalue 1; a DesignError where there is none."""
    found = []
    for matrix in (A, A.T):
        rates, modes = np.linalg.eig(matrix)
        at = int(np.abs(rates - 1.0).argmin())
        if not abs(rates[at] - 1.0) <= EQUAL:
            raise DesignError("the plant does not integrate")
        found.append(np.real(modes[:, at]))
    v, l = found
    seen, kept = float(C[0] @ v), float(l @ v)
    if abs(seen) <= SHOWN * float(np.abs(C[0]) @ np.abs(v)) or abs(kept) <= SHOWN * float(np.abs(l) @ np.abs(v)):
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
