"""The law of a controller as tables that any language can run: which gains belong to which age, and how its state goes on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from design.controllers import (
    GainTable,
    LinearFeedback,
    ages_told,
    feedforward,
    integrates,
    packet_samples,
    sojourns_told,
)
from design.controllers.gain_rows_many import sojourn_ranges
from hil.compose.loop import Loop


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LawTables:
    """u_row = Omega r + K[table, row] z, xi' = F z; z are the errors y - r of the newest samples, and the state xi.

    Args:
        omega: feedforward, (m, p).
        gains: K, (tables, rows, m, width).
        state: F, (state, width).
        state_first: z is (xi, e), else (e, xi): sums are rounded in this order.
        samples: samples of every output in e.
        ages: of each sensor node how many ages have tables of their own; empty where the oldest age has the table.
        ranges: of each age the first and the last of its tables, for 1, 2, ... slots at this age; the last entry for all beyond.
        why_none: why the tables hold zeros; empty where they are the controller's.
    """

    omega: NDArray[np.float64]
    gains: NDArray[np.float64]
    state: NDArray[np.float64]
    state_first: bool
    samples: int
    ages: tuple[int, ...]
    ranges: tuple[tuple[int, int], ...]
    why_none: str = ""


def law_tables(loop: Loop) -> LawTables:
    """Return the tables of a loop's controller; zeros, and why, of one that states neither gains nor matrices."""
    controller, model = loop.controller, loop.model
    m, p = model.B.shape[1], model.C.shape[0]
    if isinstance(controller, GainTable):
        K = np.asarray(controller.table(model), dtype=float)
        integral, samples = integrates(controller), packet_samples(controller)
        stays, ages = sojourns_told(controller), ages_told(controller)
        sojourns = (1,) * len(K) if isinstance(stays, int) or not stays else tuple(stays)
        width = p * (samples + integral)
        moved = np.zeros((p * integral, width))  # the sum of the newest errors
        for i in range(len(moved)):
            moved[i, [i, p * samples + i]] = 1.0
        return LawTables(
            omega=feedforward(model), gains=K, state=moved, state_first=False, samples=samples,
            ages=ages if len(ages) > 1 else (), ranges=tuple(sojourn_ranges(sojourns)),
        )  # fmt: skip
    if isinstance(controller, LinearFeedback):
        law = controller.linear_law(model)
        return LawTables(
            omega=feedforward(model), gains=np.hstack([law.C, law.D])[None, None], state=np.hstack([law.A, law.B]),
            state_first=True, samples=1, ages=(), ranges=((0, 0),),
        )  # fmt: skip
    return LawTables(
        omega=np.zeros((m, p)), gains=np.zeros((1, loop.rows, m, p * loop.samples)), state=np.zeros((0, p * loop.samples)),
        state_first=False, samples=loop.samples, ages=(), ranges=((0, 0),),
        why_none=f"the controller {loop.experiment.kinds.get('controller', '?')!r} is no table of gains",
    )  # fmt: skip
