"""The exact test: spectral radius of the second-moment operator from one jump to the next.

    T_ji = int_0^inf f_ij(h) Phi_i(h) (x) Phi_i(h) dh,    f_ij = lambda_ij e^(-H_i),    Phi_i(h) = transition matrix of mode i

The second moments after jump k are vec M_j(k+1) = sum_i T_ji vec M_i(k), so the loop is mean-square stable if and only if
the radius is below 1 (and the integral over the last, endless cell exists). With e^(beta h) under the integral, the largest
beta that keeps the radius below 1 is the exact decay rate of E|x|^2. Necessary and sufficient for a certain system, also for
one whose uncertainty is constant; free time variation can be worse.

Integration: Gauss-Legendre per step, Phi by fourth-order Magnus steps (exact where the gain is held), steps halved until the
radius settles; the last cell, where rates and gain are constant, in closed form lambda_ij ((L - beta) I - A (+) A)^(-1).

Reference: findings, "exact" and section 1.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from design.controllers.scheduled_gain import ScheduledGain
from design.errors import DesignError
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.matrix_exponential import exponential
from design.semi_markov_loop.system import JumpSystem

FloatArray = npt.NDArray[np.float64]
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _ModeMoments:
    """One mode's integrand: nodes h, weights f_ij(h) dh (nodes, N), Phi(x)Phi (nodes, n^2, n^2), and the endless cell."""

    h: FloatArray
    weights: FloatArray
    squares: FloatArray
    tail_start: float
    tail_rates: FloatArray | None
    tail_square: FloatArray
    tail_generator: FloatArray


def _kron2(matrix: FloatArray) -> FloatArray:
    n = matrix.shape[-1]
    product = np.einsum("...ij,...kl->...ikjl", matrix, matrix)
    return np.asarray(product.reshape(*matrix.shape[:-2], n * n, n * n))


def _closed_loop(
    system: JumpSystem, gain: ScheduledGain, mode: int, left: float, right: float
) -> tuple[FloatArray, FloatArray]:
    # A(h) at the left end and its slope, on a piece without section starts inside
    k0 = gain.at(mode, left)
    a0 = system.a[mode] + system.b[mode] @ k0
    if gain.schedule == "hold" or left >= gain.starts_s[mode, -1]:
        return a0, np.zeros_like(a0)
    return a0, system.b[mode] @ (gain.at(mode, right) - k0) / (right - left)


def _transitions(a0: FloatArray, slope: FloatArray, offset: float, lengths: FloatArray) -> FloatArray:
    """Phi from ``offset`` to offset + lengths for A(s) = a0 + slope s (fourth-order Magnus)."""
    if not slope.any():
        return exponential(a0 * lengths[:, None, None])
    x = lengths[:, None, None]
    shift = math.sqrt(3.0) / 6.0
    first, second = a0 + slope * (offset + x * (0.5 - shift)), a0 + slope * (offset + x * (0.5 + shift))
    commutator = second @ first - first @ second
    return exponential(0.5 * x * (first + second) + math.sqrt(3.0) / 12.0 * x * x * commutator)


def _mode_moments(system: JumpSystem, gain: ScheduledGain, process: SemiMarkov, mode: int, parts: int) -> _ModeMoments:
    n, settled = system.states, process.settled(mode)
    starts = gain.starts_s[mode]
    end = max(settled, float(starts[-1]))
    if not math.isfinite(end):  # rates that never settle: go to where a sojourn still lasts with probability 1e-30
        end = float(process.sojourn(mode, np.array(69.0)))
        if not math.isfinite(end):
            raise DesignError(
                f"rates[{mode}]: die out without settling; the exact operator needs them constant at last"
            )
    edges = sorted({0.0, end, *(b for b in (*process.breaks(mode), *starts.tolist()) if b < end)})
    phi = np.eye(n)
    hs, weights, squares = [], [], []
    for left, right in itertools.pairwise(edges):
        a0, slope = _closed_loop(system, gain, mode, left, right)
        speed = max(np.linalg.norm(a0, 2), np.linalg.norm(a0 + slope * (right - left), 2))
        rate = float(process.rate(mode, np.array([left, 0.5 * (left + right), right])).max())
        finest = 0.25 if slope.any() else 2.0  # largest |A| step: Magnus steps have an error of their own
        steps = parts * max(1, math.ceil((right - left) * max(speed, min(rate, 1e3)) / finest))
        width = (right - left) / steps
        lengths = np.append(0.5 * width * (_POINTS + 1.0), width)
        fixed = None if slope.any() else _transitions(a0, slope, 0.0, lengths)
        for step in range(steps):
            local = _transitions(a0, slope, step * width, lengths) if fixed is None else fixed
            here = local @ phi
            h = left + step * width + lengths[:-1]
            density = process.rate(mode, h) * np.exp(-process.integral(mode, h))[:, None]
            hs.append(h)
            weights.append(density * (0.5 * width * _WEIGHTS)[:, None])
            squares.append(_kron2(here[:-1]))
            phi = here[-1]
    tail = system.a[mode] + system.b[mode] @ gain.at(mode, end)
    generator = np.kron(tail, np.eye(n)) + np.kron(np.eye(n), tail)
    rates = process.rate(mode, end) if math.isfinite(settled) else None
    return _ModeMoments(
        h=np.concatenate(hs) if hs else np.zeros(0),
        weights=np.concatenate(weights) if hs else np.zeros((0, process.modes)),
        squares=np.concatenate(squares) if hs else np.zeros((0, n * n, n * n)),
        tail_start=end,
        tail_rates=rates,
        tail_square=_kron2(phi) * math.exp(-float(process.integral(mode, end))),
        tail_generator=generator,
    )


def _operator(moments: list[_ModeMoments], beta: float) -> FloatArray | None:
    """T(beta), shape (N n^2, N n^2), or None where an integral over an endless cell does not exist."""
    modes, size = len(moments), moments[0].tail_square.shape[0]
    out = np.zeros((modes, size, modes, size))
    for i, mode in enumerate(moments):
        out[:, :, i, :] += np.einsum("kj,kab->jab", mode.weights * np.exp(beta * mode.h)[:, None], mode.squares)
        if mode.tail_rates is None:
            continue
        total = float(mode.tail_rates.sum())
        if np.linalg.eigvals(mode.tail_generator).real.max() + beta >= total:
            return None
        inverse = np.linalg.solve((total - beta) * np.eye(size) - mode.tail_generator, mode.tail_square)
        out[:, :, i, :] += np.exp(beta * mode.tail_start) * mode.tail_rates[:, None, None] * inverse
    return out.reshape(modes * size, modes * size)


def _radius(moments: list[_ModeMoments], beta: float = 0.0) -> float:
    operator = _operator(moments, beta)
    return math.inf if operator is None else float(np.abs(np.linalg.eigvals(operator)).max())


def _settled_moments(system: JumpSystem, gain: ScheduledGain, process: SemiMarkov) -> tuple[list[_ModeMoments], float]:
    if system.uncertainty is not None:
        raise ValueError("uncertainty: the exact test is for certain systems; use at_vertex, or method 'pwl'")
    radius = math.nan
    for parts in (1, 2, 4, 8):
        moments = [_mode_moments(system, gain, process, i, parts) for i in range(system.modes)]
        new = _radius(moments)
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
    """The exact decay rate of E|x|^2 (1/s), negative if the loop is unstable; raises as ``second_moment_radius``."""
    moments, radius = _settled_moments(system, gain, process)
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
    """The verdict of the exact test as a certificate. Raises ValueError on an uncertain system: pick a vertex first."""
    radius, decay = second_moment_radius(system, gain, process), second_moment_decay(system, gain, process)
    stable = radius < 1.0 - 1e-9
    verdict = "mean-square stable" if stable else "not mean-square stable"
    return JumpCertificate(
        method="exact", sound=True, verdict="certified" if stable else "refused", gain=gain, spectral_radius=radius,
        reason=f"{verdict}: second moments are multiplied by {radius:.6g} per jump at worst", decay_rate=decay,
        margin=1.0 - radius, assumptions=("the system and the rates are exactly as given",),
    )  # fmt: skip
