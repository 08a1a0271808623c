"""The exact test: spectral radius of the second-moment operator from one jump to the next.

    T_ji = int_0^inf f_ij(h) Phi_i(h) (x) Phi_i(h) dh,    f_ij = lambda_ij e^(-H_i),    Phi_i(h) = transition matrix of mode i

The second moments after jump k are svec M_j(k+1) = sum_i T_ji svec M_i(k), so the loop is mean-square stable if and only if
the radius is below 1 (and the integral over the last, endless cell exists). With e^(beta h) under the integral, a beta that
keeps the radius below 1 is a rate at which E|x|^2 decays: a bound from below, which modes that
contract very differently make loose. Necessary and sufficient for a certain system, also for
one whose uncertainty is constant; free time variation can be worse.

Integration: Gauss-Legendre per step, Phi by fourth-order Magnus steps (exact where the gain is held), steps halved until the
radius settles; the last cell, where rates and gain are constant, in closed form lambda_ij ((L - beta) I - A (+) A)^(-1).
Where the rates never settle, the integral exists if the growth 2 max Re eig(A) + beta is below the limit of the total rate, and
not if it is above; it is followed until what is left is about e^(-69) of the whole.

Reference: ERRATA 1 and 7.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from msgspec import Struct
from scipy.linalg import expm

from design.controllers.scheduled_gain import ScheduledGain
from design.errors import DesignError, FieldError
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop import FloatArray, JumpSystem
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.period_moments import congruence, moment_operators, svec_size

_LEFT_OUT = 30.0
"""What is left out of an endless integral is at most about e^-30 of it."""
_STEPS = 200_000
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(8)


class _ModeMoments(Struct, frozen=True, kw_only=True, eq=False):
    """One mode's integrand: nodes h, weights f_ij(h) dh (nodes, N), Phi(x)Phi on svec (nodes, q, q), and the endless cell.

    Where the rates never settle, ``tail_rates`` is None, ``limit`` the limit of their total, and ``spent`` the H that was used up
    from the last start of a section, ``tail_span`` seconds before the end.
    """

    h: FloatArray
    weights: FloatArray
    squares: FloatArray
    tail_start: float
    tail_rates: FloatArray | None
    tail_square: FloatArray
    tail_generator: FloatArray
    growth: float
    limit: float = math.nan
    spent: float = 0.0
    tail_span: float = 0.0

    def exists(self, beta: float) -> bool:
        """Whether the integral over the endless cell is finite at beta and, where rates never settle, followed far enough."""
        if self.tail_rates is not None:
            return self.growth + beta < float(self.tail_rates.sum())
        return self.growth + beta < self.limit and self.spent - (self.growth + beta) * self.tail_span >= _LEFT_OUT


def _closed_loop(system: JumpSystem, gain: ScheduledGain, mode: int, left: float, right: float) -> tuple[FloatArray, FloatArray]:
    # A(h) at the left end and its slope, on a piece without section starts inside
    k0 = gain.at(mode, left)
    a0 = system.a[mode] + system.b[mode] @ k0
    if gain.schedule == "hold" or left >= gain.starts_s[mode, -1]:
        return a0, np.zeros_like(a0)
    return a0, system.b[mode] @ (gain.at(mode, right) - k0) / (right - left)


def _transitions(a0: FloatArray, slope: FloatArray, offsets: FloatArray, lengths: FloatArray) -> FloatArray:
    """Phi from offsets (steps,) to offset + lengths (l,) for A(s) = a0 + slope s (fourth-order Magnus), (steps, l, n, n)."""
    x = lengths[:, None, None]
    if not slope.any():  # the same in every step
        return np.broadcast_to(expm(a0 * x), (offsets.size, lengths.size, *a0.shape))
    shift, at = math.sqrt(3.0) / 6.0, offsets[:, None, None, None]
    first, second = a0 + slope * (at + x * (0.5 - shift)), a0 + slope * (at + x * (0.5 + shift))
    commutator = second @ first - first @ second
    return np.asarray(expm(0.5 * x * (first + second) + math.sqrt(3.0) / 12.0 * x * x * commutator))


@np.errstate(over="ignore", invalid="ignore")
def _mode_moments(system: JumpSystem, gain: ScheduledGain, process: SemiMarkov, mode: int, parts: int) -> _ModeMoments:
    n, q, settled = system.states, svec_size(system.states), process.settled(mode)
    starts = gain.starts_s[mode]
    last = system.a[mode] + system.b[mode] @ gain.at(mode, float(starts[-1]))
    growth = 2.0 * float(np.linalg.eigvals(last).real.max())
    never = not math.isfinite(settled)
    end = _far_enough(process, mode, float(starts[-1]), growth) if never else max(settled, float(starts[-1]))
    graded = end * 0.5 ** np.arange(1, 200) if never else np.zeros(0)
    graded = graded[: 1 + int(np.sum(process.integral(mode, graded) > 1e-14))]  # a rate may be infinite at 0
    edges = sorted({0.0, end, *(b for b in (*process.breaks(mode), *starts.tolist(), *graded.tolist()) if b < end)})
    phi = np.eye(n)
    hs, weights, squares = [], [], []
    for left, right in itertools.pairwise(edges):
        a0, slope = _closed_loop(system, gain, mode, left, right)
        speed = max(np.linalg.norm(a0, 2), np.linalg.norm(a0 + slope * (right - left), 2))
        rate = float(process.rate(mode, np.array([left, 0.5 * (left + right), right])).max())
        finest = 0.25 if slope.any() else 2.0  # largest |A| step: Magnus steps have an error of their own
        steps = parts * max(1, math.ceil((right - left) * max(speed, min(rate, 1e3)) / finest))
        if steps > _STEPS:
            raise DesignError(f"second-moment operator: a sojourn in mode {mode + 1} takes more than {_STEPS} steps")
        width = (right - left) / steps
        lengths = np.append(0.5 * width * (_POINTS + 1.0), width)
        h = left + width * np.arange(steps)[:, None] + lengths[:-1]
        begun = process.integral(mode, left + width * np.arange(steps + 1))
        density = process.rate(mode, h) * np.exp(begun[:-1, None] - process.integral(mode, h))[:, :, None]
        hs.append(h.ravel())
        weights.append((density * (0.5 * width * _WEIGHTS)[:, None]).reshape(h.size, -1))
        local = _transitions(a0, slope, width * np.arange(steps), lengths)
        across = local[:, -1] * np.exp(0.5 * (begun[:-1] - begun[1:]))[:, None, None]
        starts_of_steps = np.empty((steps, n, n))
        for step in range(steps):  # phi carries e^(-H/2), so that neither factor leaves the range of floats
            starts_of_steps[step] = phi
            phi = across[step] @ phi
        squares.append(congruence(local[:, :-1] @ starts_of_steps[:, None]).reshape(-1, q, q))
    tail = system.a[mode] + system.b[mode] @ gain.at(mode, end)
    rates = process.rate(mode, end) if math.isfinite(settled) else None
    return _ModeMoments(
        h=np.concatenate(hs) if hs else np.zeros(0),
        weights=np.concatenate(weights) if hs else np.zeros((0, process.modes)),
        squares=np.concatenate(squares) if hs else np.zeros((0, q, q)),
        tail_start=end,
        tail_rates=rates,
        tail_square=congruence(phi),
        tail_generator=moment_operators(tail[None])[0],
        growth=growth,
        limit=process.limit(mode),
        spent=float(process.integral(mode, end) - process.integral(mode, float(starts[-1]))),
        tail_span=end - float(starts[-1]),
    )


def _far_enough(process: SemiMarkov, mode: int, start: float, growth: float) -> float:
    """Where to end the integral over a sojourn whose rates never settle. Raises DesignError where that cannot be said."""
    limit = process.limit(mode)
    if math.isnan(limit):
        raise DesignError(f"rates[{mode}]: do not settle and state no limit")
    if math.isfinite(limit) and abs(growth - limit) <= 1e-9 * max(1.0, limit):
        raise DesignError(f"rates[{mode}]: tend to {limit:g}/s, at which second moments grow just as fast; not decided")
    fastest = growth if growth < limit else 0.0  # beyond the limit no end is far enough: exists() says so
    span = 1e-9
    while float(process.integral(mode, start + span) - process.integral(mode, start)) - fastest * span < 69.0:
        span *= 1.25
        if span > 1e12:
            raise DesignError(f"rates[{mode}]: die out so slowly that the exact operator cannot be integrated")
    return start + span


@np.errstate(over="ignore", invalid="ignore")
def _operator(moments: list[_ModeMoments], beta: float) -> FloatArray | None:
    """T(beta), shape (N q, N q), or None where an integral over an endless cell does not exist."""
    if not all(mode.exists(beta) for mode in moments):
        return None
    modes, size = len(moments), moments[0].tail_square.shape[0]
    out = np.zeros((modes, size, modes, size))
    for i, mode in enumerate(moments):
        out[:, :, i, :] += np.einsum("kj,kab->jab", mode.weights * np.exp(beta * mode.h)[:, None], mode.squares)
        if mode.tail_rates is None:
            continue
        total = float(mode.tail_rates.sum())
        inverse = np.linalg.solve((total - beta) * np.eye(size) - mode.tail_generator, mode.tail_square)
        out[:, :, i, :] += np.exp(beta * mode.tail_start) * mode.tail_rates[:, None, None] * inverse
    return out.reshape(modes * size, modes * size)


def _radius(moments: list[_ModeMoments], beta: float = 0.0) -> float:
    operator = _operator(moments, beta)
    if operator is None or not np.isfinite(operator).all():  # larger than any float
        return math.inf
    return float(np.abs(np.linalg.eigvals(operator)).max())


def _settled_moments(system: JumpSystem, gain: ScheduledGain, process: SemiMarkov) -> tuple[list[_ModeMoments], float]:
    if system.uncertainty is not None:
        raise FieldError("uncertainty", "the exact test is for certain systems; use at_vertex, or method 'pwl'")
    radius = math.nan
    for parts in (1, 2, 4, 8):
        moments = [_mode_moments(system, gain, process, i, parts) for i in range(system.modes)]
        new = _radius(moments)
        if new == math.inf and all(mode.exists(0.0) for mode in moments):
            raise DesignError("second-moment operator: second moments within a sojourn are larger than any float")
        if new == radius or abs(new - radius) <= 1e-8 * new:
            return moments, new
        radius = new
    raise DesignError("second-moment operator: the integral does not settle", value=radius)


def second_moment_radius(system: JumpSystem, gain: ScheduledGain, process: SemiMarkov) -> float:
    """Spectral radius of the per-jump operator: below 1 if and only if the loop is mean-square stable.

    Raises:
        ValueError: the system is uncertain.
        DesignError: rates that die out without settling, an integral that does not settle.
    """
    return _settled_moments(system, gain, process)[1]


def second_moment_decay(system: JumpSystem, gain: ScheduledGain, process: SemiMarkov) -> float:
    """A lower bound of the decay rate of E|x|^2 (1/s), negative if the loop is unstable; raises as ``second_moment_radius``."""
    return _decay(*_settled_moments(system, gain, process))


def _decay(moments: list[_ModeMoments], radius: float) -> float:
    low, high = (0.0, 1.0) if radius < 1.0 else (-1.0, 0.0)
    while radius < 1.0 and _radius(moments, high) < 1.0 and high < 1e6:
        low, high = high, 2.0 * high
    while radius >= 1.0 and _radius(moments, low) >= 1.0 and low > -1e6:
        low, high = 2.0 * low, low
    while high - low > 1e-7 * max(1.0, abs(high)):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _radius(moments, middle) < 1.0 else (low, middle)
    return low


def exact_certificate(system: JumpSystem, gain: ScheduledGain, process: SemiMarkov) -> JumpCertificate:
    """The verdict of the exact test as a certificate; undecided where the operator is not to be had.

    Raises ValueError on an uncertain system: pick a vertex first.
    """
    try:
        moments, radius = _settled_moments(system, gain, process)
    except DesignError as error:
        return JumpCertificate(method="exact", verdict="undecided", reason=str(error), gain=gain)
    decay, stable = _decay(moments, radius), radius < 1.0 - 1e-9
    verdict = "mean-square stable" if stable else "not mean-square stable"
    return JumpCertificate(
        method="exact", verdict="certified" if stable else "refused", gain=gain, spectral_radius=radius,
        reason=f"{verdict}: second moments are multiplied by {radius:.6g} per jump at worst", decay_rate=decay,
        margin=1.0 - radius, assumptions=("the system and the rates are exactly as given",),
    )  # fmt: skip
