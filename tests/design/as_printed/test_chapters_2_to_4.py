"""The printed conditions of Chapters 2 to 4, as matrices."""

from __future__ import annotations

import numpy as np

from design.as_printed import chapter3_system
from design.as_printed.chapters_2_to_4 import inequality_at
from design.semi_markov_loop.certificate import JumpCertificate


def test_a_mode_that_jumps_go_to_adds_its_rate_times_what_they_land_in() -> None:
    """(3.41) at one rate, its last block taken away by a Schur complement: at no rate, and r (X_i X_j^-1 X_i - X_i)."""
    rng, system, rate = np.random.default_rng(4), chapter3_system(), 0.5
    X = {f"X[{i}]": (s := rng.normal(size=(4, 4))) @ s.T + np.eye(4) for i in range(3)}
    matrices = X | {f"U[{i}]": rng.normal(size=(2, 4)) for i in range(3)} | {"Q": 3.0 * np.eye(4)}
    found = JumpCertificate(method="printed", verdict="certified", reason="", gamma=0.8, matrices=matrices)
    still, at = (inequality_at(system, found, 0, rates, 2.0) for rates in ((0.0, 0.0, 0.0), (0.0, rate, 0.0)))
    size = len(still)
    less = at[:size, :size] - at[:size, size:] @ np.linalg.solve(at[size:, size:], at[size:, :size]) - still
    x, to = X["X[0]"], X["X[1]"]
    np.testing.assert_allclose(less[:4, :4], rate * (x @ np.linalg.solve(to, x) - x), atol=1e-9)
    np.testing.assert_allclose(less[4:], 0.0, atol=1e-9)
