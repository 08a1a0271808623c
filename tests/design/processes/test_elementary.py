"""Elementary functions whose bits depend on the number alone: as good as numpy's, and the same wherever an entry stands."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from design.processes import elementary

POSITIVE = np.concatenate([np.geomspace(1e-300, 1e300, 997), [1.0, 0.5, 2.0, 0.0, np.inf]])
SIGNED = np.concatenate([-np.geomspace(1e-12, 700.0, 499), np.geomspace(1e-12, 700.0, 500), [0.0, -np.inf, np.inf]])

FUNCTIONS: list[tuple[Callable[..., np.ndarray], Callable[..., np.ndarray], np.ndarray, float]] = [
    (elementary.log, np.log, POSITIVE, 4e-16),
    (elementary.log1p, np.log1p, np.concatenate([POSITIVE, [-0.3, -0.7, -0.1, -1e-9]]), 4e-16),
    (elementary.exp, np.exp, SIGNED, 1e-15),
    (elementary.expm1, np.expm1, SIGNED, 1e-15),
    (lambda x: elementary.power(x, 2.0), lambda x: x**2.0, POSITIVE, 1e-15),
    (lambda x: elementary.power(x, -2.0), lambda x: x**-2.0, np.geomspace(1e-150, 1e150, 997), 1e-15),
    (lambda x: elementary.power(x, -0.3), lambda x: x**-0.3, POSITIVE, 1e-13),
    (lambda x: elementary.power(x, 1.7), lambda x: x**1.7, POSITIVE, 3e-13),
]
NAMES = ["log", "log1p", "exp", "expm1", "square", "inverse square", "root", "power"]


@pytest.mark.parametrize(("ours", "numpys", "x", "rel"), FUNCTIONS, ids=NAMES)
def test_it_is_the_function(
    ours: Callable[..., np.ndarray], numpys: Callable[..., np.ndarray], x: np.ndarray, rel: float
) -> None:
    with np.errstate(all="ignore"):
        assert ours(x) == pytest.approx(numpys(x), rel=rel, abs=5e-324)


@pytest.mark.parametrize(("ours", "numpys", "x", "rel"), FUNCTIONS, ids=NAMES)
def test_an_entry_has_the_same_bits_wherever_it_stands(
    ours: Callable[..., np.ndarray], numpys: Callable[..., np.ndarray], x: np.ndarray, rel: float
) -> None:
    with np.errstate(all="ignore"):
        whole = ours(x)
        assert [ours(entry).item() for entry in x] == whole.tolist()
        assert ours(x[::-1])[::-1].tolist() == whole.tolist() and ours(x[3::5]).tolist() == whole[3::5].tolist()
