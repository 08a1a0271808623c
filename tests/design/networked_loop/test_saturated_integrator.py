"""Where a loop around an integrator ends whose input saturates: no order of delays leads out, and a bad one comes near."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from design.errors import DesignError
from design.networked_loop.saturated_integrator import Ends, limited_motion

Array = NDArray[np.float64]
LIMIT, GAINS, DELAY = 0.058, np.array([-0.198, -0.1232, -0.0747]), 3


def motor(pole: float = 3.5287, period_s: float = 0.05) -> tuple[Array, Array, Array]:
    held = expm(np.array([[0.0, 1.0, 0.0], [0.0, -pole, 172.38], [0.0, 0.0, 0.0]]) * period_s)
    return held[:2, :2], held[:2, 2:], np.array([[1.0, 0.0]])


A, B, C = motor()
PUSHES = 0.006 * B


def ends(limit: float = LIMIT, gains: Array = GAINS, delay: int = DELAY, pushes: Array = PUSHES, adds: float = 0.0019,
         plant: tuple[Array, Array, Array] = (A, B, C), own: Array | None = None) -> Ends:  # fmt: skip
    return limited_motion(*plant, limit=limit, delay=delay, pushes=pushes, adds=adds).ends_in_every_order(gains, own)


def furthest(x: Array, order: str, seed: int = 0) -> Array:
    """The largest |x| in the second half of a run, in one order of delays and gains, pushed as it hurts most."""
    rng, past, seen = np.random.default_rng(seed), [x] * (DELAY + 1), np.zeros(2)
    for k in range(1200):
        delay = DELAY if order == "latest" else int(rng.integers(DELAY + 1))
        gain = GAINS[0] if order == "latest" else rng.choice(GAINS)
        u = gain * (past[-1 - delay][0] + 0.0019 * np.sign(past[-1][0]) * (-1.0 if order == "latest" else 1.0))
        x = A @ x + B[:, 0] * np.clip(u, -LIMIT, LIMIT) + PUSHES[:, 0] * np.sign(past[-1][1] or 1.0)
        past = [*past[1:], x]
        seen = np.maximum(seen, np.abs(x)) if k >= 600 else seen
    return seen


@pytest.mark.parametrize("start", [(0.0, 0.0), (15.0, 0.0), (-8.0, 60.0)])
@pytest.mark.parametrize("order", ["latest", "random"])
def test_no_order_of_delays_ends_outside(order: str, start: tuple[float, float]) -> None:
    assert (furthest(np.array(start), order) < ends().states).all()


TABLES = np.array([[[-0.2, 0.05, -0.02], [-0.1, 0.02, 0.0]], [[-0.15, 0.03, 0.04], [-0.2, -0.1, 0.0]]])
"""[table][row] of the sample and two states of the controller's own, and what makes these."""
OWN = np.array([[[0.4, 0.3, 0.1], [1.0, 0.0, 0.0]], [[0.3, -0.4, 0.2], [1.0, 0.1, 0.0]]])


def remembering(x: Array, order: str, tables: Array = TABLES, own: Array = OWN) -> Array:
    """The largest |x| in the second half of a run with a controller that remembers, its packets up to a slot old."""
    rng, past, xi, seen, packets = np.random.default_rng(1), [x] * DELAY, np.zeros(len(own[0])), np.zeros(2), []
    for k in range(1600):
        lag, d = (DELAY - 1, 1) if order == "latest" else (int(rng.integers(DELAY)), int(rng.integers(2)))
        table = k % 2 if order == "latest" else int(rng.integers(2))
        e = past[-1 - lag][0] + 0.0019 * np.sign(past[-1][0]) * (-1.0 if order == "latest" else 1.0)
        packets, xi = [*packets[-1:], tables[table] @ np.append(e, xi)], own[table] @ np.append(e, xi)
        u = packets[-1 - min(d, len(packets) - 1)][d]
        x = A @ x + B[:, 0] * np.clip(u, -LIMIT, LIMIT) + PUSHES[:, 0] * np.sign(past[-1][1] or 1.0)
        past, seen = [*past[1:], x], np.maximum(seen, np.abs(x)) if k >= 800 else seen
    return seen


@pytest.mark.parametrize("start", [(0.0, 0.0), (15.0, 0.0), (-8.0, 60.0)])
@pytest.mark.parametrize("order", ["latest", "random"])
def test_a_controller_that_remembers_ends_within_what_it_makes_of_earlier_samples(order: str, start: tuple[float, float]) -> None:
    found = ends(gains=TABLES, own=OWN)
    assert (remembering(np.array(start), order) < found.states).all() and found.output > ends(gains=TABLES[..., 0]).output


def test_what_is_remembered_is_the_sum_over_every_order_of_tables() -> None:
    motion = limited_motion(A, B, C, limit=LIMIT, delay=DELAY, pushes=PUSHES, adds=0.0019)
    acts, strays, unknown = motion._remembered(TABLES, OWN)
    rng = np.random.default_rng(0)
    for _ in range(200):
        xi, sums = np.zeros(2), np.zeros(2)
        order = rng.integers(0, 2, 40)
        for table in order:
            xi = OWN[table] @ np.append(1.0, xi)
        for row in (0, 1):
            at = TABLES[order[-1], row] @ np.append(1.0, xi)
            assert np.abs(at - acts).min() <= unknown.max() and sums.sum() == 0.0
    once = motion._remembered(TABLES[:1, :1], OWN[:1])  # of one table every h_j is known
    h, of = [], TABLES[0, 0, 1:]
    for _ in range(200):
        h, of = [*h, of @ OWN[0, :, 0]], of @ OWN[0, :, 1:]
    slots = np.arange(1, 201)
    assert once[0] == pytest.approx(TABLES[0, 0, 0] + np.sum(h)) and strays.shape == acts.shape
    assert once[1] == pytest.approx(np.abs(h) @ (motion.earlier + slots * motion.slope))


@pytest.mark.parametrize(
    ("size", "weight", "said"),
    [(1.5, 1.0, "own state may grow"), (1.2, 1.0, "no norm was found"), (0.5, 10.0, "not every gain leads"), (0.5, 1.0, "")],
)
def test_a_state_that_grows_in_some_order_or_leads_away_ends_nowhere(size: float, weight: float, said: str) -> None:
    """Of two nilpotent tables each forgets, and both in turn grow by the square of 1.2, though seldom for long."""
    own = np.array([[[0.3, 0.0, size], [0.3, 0.0, 0.0]], [[0.3, 0.0, 0.0], [0.3, size, 0.0]]])
    with pytest.raises(DesignError, match=said) if said else nullcontext():
        ends(gains=TABLES * [1.0, weight, weight], own=own)


def test_the_bound_is_near_to_what_a_late_order_reaches() -> None:
    reached = furthest(np.array([3.0, 0.0]), "latest")
    assert (reached > 0.3 * ends().states).all()


def test_the_bound_of_an_integrator_with_a_lag_is_its_sum() -> None:
    """x(k+1) = x(k) + y(k), y(k+1) = y(k) / 2 + sat(u(k)): both end within H = 4 L and, by the filter of z, within 2 (D + M)."""
    plant = np.array([[1.0, 1.0], [0.0, 0.5]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    found = ends(1.0, np.array([-0.1]), 3, np.zeros((2, 1)), 0.25, plant)  # z = x + 2 y: b = 2, M = 2, H = 2 sum_j 2^-j = 4
    assert found.output == pytest.approx(4.0 + 3.0 * 2.0 + 0.25 + 2.0, rel=1e-2)
    assert found.states[1] == pytest.approx(2.0, rel=1e-2)


def test_what_it_leans_on_changes_it() -> None:
    found = ends()
    assert found.output == pytest.approx(found.states[0]) and found.share == pytest.approx(0.006 / LIMIT)
    assert ends(delay=6).output > found.output + 3 * 48.0 * 0.05 * LIMIT
    assert ends(pushes=2.0 * PUSHES).output > found.output and ends(adds=0.1).output > found.output
    assert ends(gains=GAINS / 10.0).output > found.output and ends(limit=2.0 * LIMIT).output > 1.5 * found.output


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gains": np.append(GAINS, 0.001)}, "not every gain leads"),
        ({"gains": -GAINS}, "not every gain leads"),
        ({"limit": 0.0059}, "as strong as the limited command"),
        ({"plant": (0.99 * A, B, C)}, "does not integrate"),
        ({"plant": (np.array([[1.0001, 300.0], [0.0, 0.9]]), B, C)}, "does not integrate"),  # unstable, in um and m/s
        ({"plant": (np.array([[1.0, 0.05], [0.0, 1.0]]), B, C)}, "more than once"),
        ({"plant": (np.eye(2), B, np.array([[1.0, 1.0]]))}, "not stable"),
        ({"plant": (np.diag([1.0, 1.01]), B, C)}, "not stable"),
        ({"plant": (A, B, np.array([[0.0, 1.0]]))}, "its output does not show it"),
    ],
)  # fmt: skip
def test_what_the_argument_does_not_carry_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(DesignError, match=message):
        ends(**change)  # type: ignore[arg-type]


def in_mean(share: float, wrong: float = 0.05, pushes: Array = PUSHES) -> Ends:
    """One gain leads back, one leads away in so large a share of the slots, whatever came before."""
    gains, chances = np.array([-0.198, wrong]), np.array([[1.0 - share, share]] * 2)
    return limited_motion(A, B, C, limit=LIMIT, delay=DELAY, pushes=pushes, adds=0.0019).ends_in_mean(gains, chances)


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_where_a_gain_leads_away_at_times_the_mean_square_ends_within(share: float) -> None:
    """400 runs from 15 rad: their root mean square is below the bound, which grows with the share."""
    rng, runs = np.random.default_rng(7), 400
    past = [np.tile([[15.0], [0.0]], (1, runs))] * (DELAY + 1)
    levels = []
    for _ in range(1500):
        gain = np.where(rng.random(runs) < share, 0.05, -0.198)
        seen = np.stack(past)[rng.integers(DELAY + 1, size=runs), 0, np.arange(runs)] + 0.0019
        x = A @ past[0] + B * np.clip(gain * seen, -LIMIT, LIMIT) + PUSHES * np.sign(past[0][:1])
        past = [x, *past[:-1]]
        levels.append(np.sqrt((x**2).mean(axis=1)))
    found = in_mean(share)
    assert (np.max(levels[1000:], axis=0) < found.states).all() and levels[0][0] > 3.0 * found.output
    assert found.output < in_mean(share + 0.05).output and found.output < in_mean(share, pushes=2.0 * PUSHES).output


def test_in_the_mean_a_loop_that_drifts_away_has_no_bound() -> None:
    """Near one half what pushes decides between directions as strong. Gains that lead back have a bound in the mean, too."""
    for share in (0.48, 0.7):
        with pytest.raises(DesignError, match="no drift towards 0"):
            in_mean(share)
    with pytest.raises(DesignError, match="no gain leads"):
        limited_motion(A, B, C, limit=LIMIT, delay=3, pushes=PUSHES, adds=0.0).ends_in_mean(-GAINS, np.full((3, 3), 1 / 3))
    assert ends().output < in_mean(0.0).output < 1.5 * ends().output
