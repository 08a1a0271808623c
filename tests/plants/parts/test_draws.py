"""Draws and sines that are the same on every machine: as good as those of the libraries, and made of plain operations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtri

from plants.parts.draws import TURN, Normals, exponential, normal_quantile, sine
from plants.parts.exponential import exp


def test_a_quantile_is_that_of_the_normal_law_from_its_middle_to_its_farthest_tail() -> None:
    inner = np.floor(np.random.default_rng(0).random(20_000) * 2.0**52) * 2.0**-52 + 2.0**-53
    tail = 2.0 ** -np.arange(1.0, 54.0)
    p = np.concatenate([inner, tail, 1.0 - tail])
    assert [normal_quantile(each) for each in p.tolist()] == pytest.approx(ndtri(p), rel=1e-14, abs=1e-15)


def test_draws_have_the_moments_of_their_law() -> None:
    # 4 sigma of every mean: a false alarm in 16,000 runs of another seed; the seed stands
    count = 100_000
    z = np.array(Normals(np.random.default_rng(3)).several(count))
    rng = np.random.default_rng(4)
    e = np.array([exponential(rng) for _ in range(count)])
    bound = 4.0 / math.sqrt(count)
    assert abs(z.mean()) < bound and abs((z**2).mean() - 1.0) < bound * math.sqrt(2.0)
    assert abs(e.mean() - 1.0) < bound and abs((e**2).mean() - 2.0) < bound * math.sqrt(20.0)


@pytest.mark.parametrize("turns", [0.0, 0.1, 0.125, 0.3, 0.49, 0.5, 0.74, 0.99, 7.31, -0.2, -3.6])
def test_a_sine_is_the_sine(turns: float) -> None:
    assert sine(turns) == pytest.approx(math.sin(TURN * turns), abs=1e-14)


@pytest.mark.parametrize("x", [0.0, 1e-9, -0.003, 0.5, -0.7, 3.0, -40.0])
def test_an_exponential_is_the_exponential(x: float) -> None:
    assert exp(x) == pytest.approx(math.exp(x), rel=1e-13)
