"""Three rooms draw semi-Markov processes, and none may see the others: one law holds all three.

Each draws 4000 sojourns out of one mode whose rates change with time. Level 1e-5 a test. Power: rates a quarter too large move
the mean sojourn by a fifth, some twelve standard errors, and the last test puts such a fault in and sees it.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from design.processes.rates import PiecewiseLinearRate
from design.processes.semi_markov import SemiMarkov
from plants.parts.flow import JumpProcess
from plants.parts.semi_markov import TransitionRates
from transport.laws.semi_markov import SemiMarkovAge
from transport.laws.sojourn import Table

NODES = (0.0, 0.4, 1.0)
OUT = (0.3, 2.0, 1.2)  # 1/s to the second mode; to the third half of it
RUNS, LEVEL, SLOT_S = 4000, 1e-5, 0.02
BACK = 1.0


def area(h, scale=1.0):
    """Integral of the rate out of the first mode, by the trapezoidal rule between the nodes."""
    h = np.asarray(h, dtype=float)
    grid = np.unique(np.concatenate([np.asarray(NODES), h.ravel(), [0.0]]))
    rate = 1.5 * scale * np.interp(grid, NODES, OUT)
    steps = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(grid))])
    return np.interp(h, grid, steps)


def plants_rates(scale=1.0):
    def generator(out):
        out *= scale
        return ((-1.5 * out, out, 0.5 * out), (BACK, -BACK, 0.0), (BACK, 0.0, -BACK))

    return TransitionRates(nodes_s=NODES, rates=tuple(generator(out) for out in OUT))


def designs_process(scale=1.0):
    out, half = (PiecewiseLinearRate(times_s=NODES, values=tuple(c * scale * v for v in OUT)) for c in (1.0, 0.5))
    back = PiecewiseLinearRate(times_s=(0.0,), values=(BACK,))
    return SemiMarkov(rates=((None, out, half), (back, None, None), (back, None, None)))


def of_plants(scale=1.0):
    """(sojourn in s, mode that follows) of the first mode, drawn by the plants' process."""
    rng, found = np.random.default_rng(21), []
    for _ in range(RUNS):
        process = JumpProcess(plants_rates(scale), 1, rng)
        at = process.next_ns
        process.fire()
        found.append((at * 1e-9, process.mode - 1))
    return np.array(found)


def of_design(scale=1.0):
    h, target = designs_process(scale).next_jump(np.zeros(RUNS, dtype=int), np.random.default_rng(22))
    return np.column_stack([h, target])


def of_transport(scale=1.0):
    """The law in slots: h = n where the jump lies in the n-th slot, so that S(n) = exp(-area(n T))."""
    survival = np.exp(-area(np.arange(0, 1500) * SLOT_S, scale))
    probabilities = -np.diff(survival)
    stay = Table(probabilities=tuple(probabilities / probabilities.sum()))
    one_slot = Table(probabilities=(1.0,))
    law = SemiMarkovAge(
        matrix=((0.0, 2 / 3, 1 / 3), (1.0, 0.0, 0.0), (1.0, 0.0, 0.0)), sojourn=(stay, one_slot, one_slot),
        ages=(0, 1, 1), initial=(1.0, 0.0, 0.0),
    )  # fmt: skip
    draw = law.start(np.random.default_rng(23)).draw
    found, slots = [], 0
    while len(found) < RUNS:
        mode = draw()[0]
        if mode == 0:
            slots += 1
        elif slots:
            found.append((slots * SLOT_S, mode))
            slots = 0
    return np.array(found)


def p_values(sample, scale=1.0):
    """Of the sojourns in 16 equally likely cells, edges on whole slots, and of the modes that follow."""
    grid = np.arange(1, 1500) * SLOT_S
    reached = 1.0 - np.exp(-area(grid, scale))
    edges = grid[np.searchsorted(reached, np.arange(1, 16) / 16)]
    expected = np.diff(np.concatenate([[0.0], np.interp(edges, grid, reached), [1.0]])) * RUNS
    counted = np.bincount(np.searchsorted(edges, sample[:, 0] - 1e-12), minlength=16)
    followed = [np.count_nonzero(sample[:, 1] == mode) for mode in (1, 2)]
    return stats.chisquare(counted, expected).pvalue, stats.chisquare(followed, [RUNS * 2 / 3, RUNS / 3]).pvalue


ROOMS = {"plants": of_plants, "design": of_design, "transport": of_transport}


def test_the_rates_are_the_same():
    plants, design = plants_rates(), designs_process()
    for h in (0.0, 0.1, 0.4, 0.73, 1.0, 5.0):
        assert plants.at(1, h) == pytest.approx(design.rate(0, h), rel=1e-12)
        assert float(np.sum(design.integral(0, h))) == pytest.approx(float(area(h)), rel=1e-9)


@pytest.mark.parametrize("room", ROOMS)
def test_sojourns_and_what_follows_are_of_one_law(room):
    assert min(p_values(ROOMS[room]())) > LEVEL


@pytest.mark.parametrize("room", ROOMS)
def test_rates_a_quarter_too_large_are_seen(room):
    assert p_values(ROOMS[room](1.25))[0] < LEVEL
