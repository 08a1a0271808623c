"""Decay rate and coefficient of Definition 3.1, proved from a certificate."""

from __future__ import annotations

import math

import numpy as np
import pytest

from design.controllers.scheduled_gain import constant_gain
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.decay_rates import decay_of
from design.semi_markov_loop.delayed_hinf import analyse_delayed
from design.semi_markov_loop.system import DelayedJumpSystem

TAU_S = 0.3
NO_JUMPS = SemiMarkov(rates=((None,),))
NO_GAIN = constant_gain(np.zeros((1, 1, 1)))


def loop(a: float, ad: float, slope: float = 0.0) -> DelayedJumpSystem:
    one = np.ones((1, 1, 1))
    return DelayedJumpSystem(a=a * one, ad=ad * one, b=one, e=one, c=0.1 * one, delay_max_s=TAU_S, delay_slopes=np.array([slope]))


def test_closed_form_of_a_scalar_loop() -> None:
    """x' = -2 x + x(t - tau) / 2 with P = 2, Q = 1: mu = 8 - 1 - 1, a = 2, b = 1."""
    proof = JumpCertificate(
        method="pwc", verdict="certified", reason="", gain=NO_GAIN,
        matrices={"P[0,0]": np.array([[2.0]]), "Q": np.array([[1.0]])},
    )  # fmt: skip
    rate, coefficient = decay_of(loop(-2.0, 0.5), NO_JUMPS, proof)
    assert rate * (2.0 + TAU_S * math.exp(rate * TAU_S)) == pytest.approx(6.0)
    assert coefficient == pytest.approx((2.0 + TAU_S + rate * TAU_S**2 * math.exp(rate * TAU_S)) / 2.0)


@pytest.mark.parametrize(("a", "ad"), [(-2.0, 0.5), (-1.0, -0.8), (-3.0, 2.0)])
def test_a_simulated_loop_stays_below_the_proved_bound(a: float, ad: float) -> None:
    system = loop(a, ad)
    rate, coefficient = decay_of(system, NO_JUMPS, analyse_delayed(system, NO_GAIN, NO_JUMPS))
    step_s = 1e-3
    x = [1.0] * round(TAU_S / step_s)
    for k in range(5000):
        x.append(x[-1] + step_s * (a * x[-1] + ad * x[-round(TAU_S / step_s)]))
        assert x[-1] ** 2 <= coefficient * math.exp(-rate * k * step_s)
    assert rate > 0.0


def test_only_a_certificate_proves_a_decay() -> None:
    refused = JumpCertificate(method="pwc", verdict="refused", reason="", gain=NO_GAIN)
    with pytest.raises(ValueError, match="certificate: refused by 'pwc', expected certified"):
        decay_of(loop(-2.0, 0.5), NO_JUMPS, refused)
