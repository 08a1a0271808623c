"""Chapter 5, what it leaves open: the input's price, the order of the sensors, any order, the theorem where it is feasible."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.as_printed.historical_data import historical_gains, newest_gains
from design.historical_data.block_diagonal import BlockDiagonalProof, largest_eigenvalue, tangent_scheme
from design.historical_data.common_lyapunov import common_bound
from design.historical_data.cone_complementarity import cone_complementarity
from design.historical_data.guaranteed_cost import average_start, cost, cyclic_orders, start_at
from design.historical_data.information import Mask, round_robin
from design.historical_data.lifted_loop import DelayedPlant, close
from design.historical_data.matched_peak import PeakMatch, largest_input, match_peak
from design.historical_data.measurement_noise import stationary_cost
from design.historical_data.orders import OrderCost, orders_by_cost
from hil.reproduce.chapter import ReportProgress
from hil.reproduce.judgement import Row, above, below, near, row
from plants.delayed_states import DelayedStates

Array = npt.NDArray[np.float64]
REMARK = "Remark 5.2: K(I(k), 0) = 0 covers a delay of one slot"


def variant_plant(plant: DelayedPlant) -> DelayedPlant:
    """Return the plant with A(3,3) = 0.6 and a quarter of every delayed matrix, on which Theorem 5.1 is feasible."""
    return DelayedPlant(A=plant.A - 0.5 * np.diag([0, 0, 1, 0]), delayed=plant.delayed / 4, B=plant.B, weight=plant.weight)


def further_rows(plant: DelayedPlant, report_progress: ReportProgress) -> list[Row]:
    """Return all rows of this stage."""
    x0, info = np.array(DelayedStates().initial_state), round_robin(4, buffer=3)
    mask = info.mask()
    rows = [delay_row(round_robin(4, buffer=3, memory=6).mask(), round_robin(4, buffer=3, memory=6, delay=1).mask())]
    report_progress("input weight")
    for name, gains in (("(5.16)", historical_gains()), ("(5.17)", newest_gains())):
        peak = largest_input(plant, gains, x0, 0)
        printed = Printed(name, cost(close(plant, gains), start_at(x0, 4, 0)), peak)
        rows.append(peak_row(printed, match_peak(plant, mask, x0, 0, peak)))
    report_progress("order of the sensors")
    orders = orders_by_cost(plant, info, average_start(4, 4))
    rows.append(order_row(orders))
    best = next(each.gains for each in orders if each.order == info.order)
    rows.append(noise_row(*(stationary_cost(plant, gains, 0.1) for gains in (historical_gains(), newest_gains(), best))))
    report_progress("any order of the sensors")
    rows.append(any_order_row(plant, historical_gains(), x0))
    report_progress("Theorem 5.1 on another plant")
    variant = variant_plant(plant)
    tangent = tangent_scheme(variant, mask, x0)
    rows += [tangent_row(variant, tangent, x0), cone_row(variant, cone_complementarity(variant, mask, x0, 14.8), tangent)]
    return rows


def delay_row(prompt: Mask, late: Mask) -> Row:
    """Return the row on the constraints of a delay; both masks (4, 7, 4)."""
    remark = prompt.copy()
    remark[:, 0] = False
    missing = int((remark & ~late).sum())
    shifted = int((late[:, 1:] != np.roll(prompt, 1, axis=0)[:, :-1]).sum())
    return row(
        REMARK, "covers it",
        near("samples that the remark uses before they have come", missing, 0.0),
        witness=(
            above("samples that the remark uses before they have come", missing, 0.0),
            near("entries in which the shifted mask of (5.8) is not what has come", shifted, 0.0),
        ),
        basis="n = 4, m = 3: a delay shifts the whole mask, K(i, j) takes the place of K(i - 1, j - 1)",
    )  # fmt: skip


class Printed(NamedTuple):
    """Printed gains from x(0) with I(0) = 1: their name, J and largest input."""

    name: str
    cost: float
    peak: float


def peak_row(printed: Printed, ours: PeakMatch) -> Row:
    """Return the row on gains of least cost with the largest input of printed ones."""
    limit = 190.0 if printed.name == "(5.16)" else 88.0
    return row(
        f"(5.18): an input weight, with the largest input of {printed.name}", "-",
        below("largest input less the printed one", ours.peak - printed.peak, 1e-9), below("J", ours.cost, limit),
        below("J, ours over the printed one", ours.cost / printed.cost, 1.0),
        basis=f"I(0) = 1: weight {ours.weight:.4g}, largest input {ours.peak:.4g}, J {ours.cost:.4g}; "
        f"{printed.name}: {printed.peak:.4g}, {printed.cost:.4g}",
    )  # fmt: skip


def order_row(found: Sequence[OrderCost]) -> Row:
    """Return the row on the order of the sensors, which (5.2) fixes; ``found`` has the cheapest order first."""
    costs = {each.order: each.cost for each in found}
    said = ", ".join(f"{'-'.join(str(node + 1) for node in order)} {value:.4f}" for order, value in costs.items())
    printed = costs[tuple(range(len(found[0].order)))]
    return row(
        "(5.2): the order of the sensors is 1, 2, 3, 4", "not argued for",
        below("mean cost of this order over that of the best", printed / found[0].cost, 1.005),
        basis=f"gains of least mean cost, m = 3, under each of {len(found)} orders: {said}",
    )  # fmt: skip


def noise_row(historical: float, newest: float, best: float) -> Row:
    """Return the row on noise of 0.1 on every sample: the stationary E x' Xi x of (5.16), (5.17) and gains of least mean cost."""
    return row(
        "(5.16) feels the noise of its sensors less than (5.17)", "-",
        below("stationary cost, (5.16) over (5.17)", historical / newest, 1.0),
        basis=f"standard deviation 0.1, a sample sent again keeps its noise: {historical:.3g}, {newest:.3g}; gains of least mean "
        f"cost without noise {best:.3g}",
    )  # fmt: skip


def any_order_row(plant: DelayedPlant, gains: Array, x0: Array) -> Row:
    """Return the row on stability whoever sends next, by one Lyapunov matrix on the stacked state."""
    columns = max(gains.shape[1], plant.memory + 1)
    X0 = np.concatenate([x0, np.zeros(len(x0) * (columns - 1))])
    bound, _ = common_bound(close(plant, gains), X0)
    worst = max(cost(close(plant, gains[list(order)]), start_at(x0, len(gains), 0)) for order in cyclic_orders(len(gains)))
    return row(
        "Theorem 5.1: one P for every phase, so for any order of the sensors", "bound 616.5",
        below("bound of J by one P on the stacked state", bound, 616.5),
        above("bound less the largest J over the six cyclic orders", bound - worst, 0.0),
        basis=f"(5.16), inequalities checked at the returned P: bound {bound:.2f}; largest J of the orders {worst:.2f}",
    )  # fmt: skip


def tangent_row(plant: DelayedPlant, proof: BlockDiagonalProof, x0: Array) -> Row:
    """Return the row on Theorem 5.1, its functional put right, on a plant that meets it."""
    worst = max(cost(close(plant, proof.gains), start_at(x0, 4, phase)) for phase in range(4))
    return row(
        "Theorem 5.1 on a plant that meets it", "-",
        below("bound of the tangent scheme", proof.bounds[-1], 14.6),
        below("largest eigenvalue of (5.9) at its answer", largest_eigenvalue(plant, proof.gains, proof.P, proof.Q), 0.0),
        below("largest J over I(0), over the bound", worst / proof.bounds[-1], 1.0),
        basis=f"A(3,3) = 0.6, delayed matrices by 4: bound {proof.bounds[0]:.3f} without gains, {proof.bounds[-1]:.3f} with, "
        f"after {len(proof.bounds) - 1} steps",
    )  # fmt: skip


def cone_row(plant: DelayedPlant, found: BlockDiagonalProof, tangent: BlockDiagonalProof) -> Row:
    """Return the row on the thesis's own scheme, asked for a bound of 14.8 on the plant that meets the theorem."""
    return row(
        "Theorem 5.1 by cone complementarity, on a plant that meets it", "-",
        below("bound of cone complementarity", found.bounds[-1], 14.8),
        below("largest eigenvalue of (5.9), X the inverse of P", largest_eigenvalue(plant, found.gains, found.P, found.Q), 0.0),
        basis=f"asked for 14.8: {found.bounds[-1]:.3f}; the tangent scheme, asked for the least, {tangent.bounds[-1]:.3f}",
    )  # fmt: skip
