"""Gains of a design run in a loop that may be later than the chains that they were designed over."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from design.controllers import LoopModel, SendAll, nested
from design.errors import FieldError
from design.processes.delay_chain import DelayChain
from design.requests.tracking import Designed, DesignTask, _covering

HALF = [[0.5, 0.5], [0.5, 0.5]]
TWO_OUTPUTS = LoopModel(A=np.eye(2), B=np.ones((2, 1)), C=np.eye(2), period_s=0.1, tau_max=1, d_max=1)
TWO, LATE = DelayChain(transition=HALF), DelayChain(transition=HALF, delays=[0, 4])


def task(**change: Any) -> DesignTask:
    one = np.eye(1)
    model = LoopModel(A=one, B=one, C=one, period_s=0.1, tau_max=3, d_max=2)
    return DesignTask(**{"model": model, "sc": TWO, "ca": TWO} | change)


def table(rows: int, tables: int = 2) -> np.ndarray:
    return np.arange(1.0, 1.0 + tables * rows).reshape(tables, rows, 1, 1)


@pytest.mark.parametrize(
    ("selection", "rows"),
    [
        ("constant", [0]), ("generated", [0, 1, 1]), ("previous", [0, 1, 1]), ("applied", [0, 1, 1]),
        ("both", [0, 1, 1, 2, 3, 3, 2, 3, 3]),
    ],
)  # fmt: skip
def test_a_delay_beyond_the_chains_has_the_gains_of_the_longest_that_they_reach(selection: Any, rows: list[int]) -> None:
    K = table(max(rows) + 1)
    found = _covering(task(), SendAll(gains=nested(K), selection=selection))
    assert np.array_equal(found.gains, K[[0, 1, 1, 1]][:, rows])


def test_what_depends_on_stays_repeats_the_longest_and_tables_of_stays_or_nodes_stay_as_they_are() -> None:
    K, more = table(4), table(2, 3)
    of_rows = _covering(task(), SendAll(gains=nested(K), selection="applied", row_sojourns=2))
    assert np.array_equal(of_rows.gains, K[[0, 1, 1, 1]][:, [0, 1, 2, 3, 3, 3]])
    for own in ({"sojourns": (1, 2)}, {"ages": (3,)}):
        found = _covering(task(), SendAll(gains=nested(more), selection="generated", **own))
        assert np.array_equal(found.gains, more[:, [0, 1, 1]])


@pytest.mark.parametrize("change", [{"sc": None}, {"ca": None}, {"ca": LATE}])
def test_gains_for_a_loop_without_chains_or_with_too_few_rows_are_the_loops_to_refuse(change: dict[str, Any]) -> None:
    given = SendAll(gains=nested(table(2)))
    assert _covering(task(**change), given) is given


@pytest.mark.parametrize(
    ("asked", "loop", "said"),
    [
        ({"output_weights": (1.0, 1.0)}, task(), "output_weights: length 2, expected 1"),
        ({}, task(sc=None, chainless="it draws"), "kind: a design needs a chain of ages on both links, but it draws"),
        ({}, task(ca=None), "kind: a design needs a chain of ages on both links, but a law states none"),
        ({"integral": 0.1}, task(model=TWO_OUTPUTS),
         "integral: 1 inputs cannot make the mean errors of 2 outputs zero"),
    ],
)  # fmt: skip
def test_what_no_design_fits_is_refused_by_its_field(asked: dict[str, Any], loop: DesignTask, said: str) -> None:
    with pytest.raises(FieldError, match=f"^{said}"):
        Designed(**asked).solve(loop)
