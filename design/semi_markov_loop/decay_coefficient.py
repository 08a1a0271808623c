"""Decay rate and decay coefficient of a delayed loop, from a certificate: E|x(t)|^2 <= sigma e^(-rate t) sup |phi|^2.

With V of `delayed_hinf` and no disturbance, AV <= -mu |x|^2 and

    p |x|^2 <= V <= a |x|^2 + b int_{t-tau}^t |x|^2,    a = max |P|, b = (1 + eta tau) |Q|, p = min 1 / |P^-1|

The integral of e^(rate t) int_{t-tau}^t |x|^2 is at most tau e^(rate tau) times that of e^(rate t) |x|^2 from -tau on, so that
the largest rate with rate (a + b tau e^(rate tau)) <= mu gives sigma = (a + b tau + rate b tau^2 e^(rate tau)) / p.

Reference: thesis Definition 3.1, (3.5), (3.14).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from design.errors import FieldError
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.delayed_hinf import fastest_exit
from design.semi_markov_loop.sojourn_grid import cells
from design.semi_markov_loop.system import DelayedJumpSystem


class Decay(NamedTuple):
    """Decay rate (1/s) and decay coefficient of (3.5)."""

    rate: float
    coefficient: float


def decay_of(system: DelayedJumpSystem, process: SemiMarkov, certificate: JumpCertificate) -> Decay:
    """Return rate and coefficient that a certificate of `analyse_delayed` (``pwc``) proves of the loop without disturbance.

    Raises:
        ValueError: the certificate is not certified, or its P is not constant per section.
    """
    if not certificate.certified or certificate.method != "pwc" or certificate.gain is None:
        raise FieldError("certificate", f"{certificate.verdict} by {certificate.method!r}, expected certified by 'pwc'")
    gain, found = certificate.gain, certificate.matrices
    sections = tuple(tuple(row.tolist()) for row in gain.starts_s)
    eta, tau, q = fastest_exit(process, sections), system.delay_max_s, found["Q"]
    least, most, smallest = math.inf, 0.0, math.inf
    for cell in cells(process, sections):
        i, p = cell.mode, found[f"P[{cell.mode},{cell.index}]"]
        a = system.a[i] + system.b[i] @ gain.at(i, cell.start)
        late = p @ system.ad[i]
        delayed = late @ np.linalg.solve((1.0 - system.delay_slopes[i]) * q, late.T)
        for rates in cell.rates:
            jumps = sum(rate * (found[f"P[{j},0]"] - p) for j, rate in enumerate(rates) if rate > 0)
            falls = -(p @ a + a.T @ p + jumps + (1.0 + eta * tau) * q + delayed)
            least = min(least, float(np.linalg.eigvalsh(falls)[0]))
        eigenvalues = np.linalg.eigvalsh(p)
        smallest, most = min(smallest, float(eigenvalues[0])), max(most, float(eigenvalues[-1]))
    held = (1.0 + eta * tau) * float(np.linalg.eigvalsh(q)[-1])

    def demand(rate: float) -> float:
        return rate * (most + held * tau * math.exp(rate * tau))

    low, high = 0.0, least / most
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if demand(middle) <= least else (low, middle)
    return Decay(low, (most + held * tau + low * held * tau * tau * math.exp(low * tau)) / smallest)
