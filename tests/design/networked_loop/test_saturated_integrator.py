"""Where a loop around an integrator ends whose input saturates: no order of delays leads out, and a bad one comes near."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from design.errors import DesignError
from design.networked_loop.saturated_integrator import Ends, ends_in_every_order

Array = NDArray[np.float64]
LIMIT, GAINS, DELAY = 0.058, np.array([-0.198, -0.1232, -0.0747]), 3


def motor(pole: float = 3.5287, period_s: float = 0.05) -> tuple[Array, Array, Array]:
    held = expm(np.array([[0.0, 1.0, 0.0], [0.0, -pole, 172.38], [0.0, 0.0, 0.0]]) * period_s)
    return held[:2, :2], held[:2, 2:], np.array([[1.0, 0.0]])


A, B, C = motor()
PUSHES = 0.006 * B


def ends(limit: float = LIMIT, gains: Array = GAINS, delay: int = DELAY, pushes: Array = PUSHES, adds: float = 0.0019,
         plant: tuple[Array, Array, Array] = (A, B, C)) -> Ends:  # fmt: skip
    return ends_in_every_order(*plant, limit=limit, gains=gains, delay=delay, pushes=pushes, adds=adds)


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
        ({"plant": (np.array([[1.0, 0.05], [0.0, 1.0]]), B, C)}, "more than once"),
        ({"plant": (np.eye(2), B, np.array([[1.0, 1.0]]))}, "not stable"),
        ({"plant": (np.diag([1.0, 1.01]), B, C)}, "not stable"),
        ({"plant": (A, B, np.array([[0.0, 1.0]]))}, "its output does not show it"),
    ],
)  # fmt: skip
def test_what_the_argument_does_not_carry_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(DesignError, match=message):
        ends(**change)  # type: ignore[arg-type]
