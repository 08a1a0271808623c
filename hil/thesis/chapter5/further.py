"""Chapter 5, what it leaves open: the input's price, the order of the sensors, any order, the theorem where it is feasible."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from design.as_printed.chapter5 import historical_gains, newest_gains
from design.historical_data.block_diagonal import (
    BlockDiagonalProof,
    common_bound,
    cone_complementarity,
    largest_eigenvalue,
    tangent_scheme,
)
from design.historical_data.guaranteed_cost import average_start, cost, start_at, stationary_cost
from design.historical_data.least_cost import cyclic_orders, largest_input, match_peak, orders_by_cost
from design.historical_data.lifted_loop import DelayedPlant, close
from design.historical_data.sensor_schedule import Mask, mask_of, round_robin
from hil.thesis.chapter import ReportProgress
from hil.thesis.statements import Statement, above, below, exactly
from plants.delayed_states import DelayedStates

Array = npt.NDArray[np.float64]


def variant_plant(plant: DelayedPlant) -> DelayedPlant:
    """Return the plant with A(3,3) = 0.6 and a quarter of every delayed matrix, on which Theorem 5.1 is feasible."""
    return DelayedPlant(A=plant.A - 0.5 * np.diag([0, 0, 1, 0]), delayed=plant.delayed / 4, B=plant.B, weight=plant.weight)


def further(plant: DelayedPlant, report_progress: ReportProgress) -> dict[str, Any]:
    """Return the numbers of this stage."""
    x0, nodes = np.array(DelayedStates().initial_state), round_robin(4, buffer=3)
    mask = mask_of(nodes)
    report_progress("input weight")
    printed = (historical_gains(), newest_gains())
    peaks = [largest_input(plant, gains, x0, 0) for gains in printed]
    J = [cost(close(plant, gains), start_at(x0, 4, 0)) for gains in printed]
    matched = [match_peak(plant, mask, x0, 0, peak) for peak in peaks]
    report_progress("order of the sensors")
    orders = orders_by_cost(plant, nodes, average_start(4, 4))
    own = next(each for each in orders if each.order == (0, 1, 2, 3))
    report_progress("any order of the sensors")
    bound, worst = any_order(plant, historical_gains(), x0)
    report_progress("Theorem 5.1 on another plant")
    variant = variant_plant(plant)
    return {
        **delay(mask_of(nodes, 6), mask_of(round_robin(4, buffer=3, delay=1))),
        "matched": matched, "peaks": peaks, "J": J, "more": [ours.peak - peak for ours, peak in zip(matched, peaks)],
        "share": [ours.cost / theirs for ours, theirs in zip(matched, J)], "order": own.cost / orders[0].cost,
        "orders": ", ".join(f"{'-'.join(str(node + 1) for node in each.order)} {each.cost:.4f}" for each in orders),
        "noise": [stationary_cost(plant, gains, 0.1) for gains in (*printed, own.gains)], "bound": bound, "worst": worst,
        "tangent": proof_numbers(variant, tangent_scheme(variant, mask, x0), x0),
        "cone": proof_numbers(variant, cone_complementarity(variant, mask, x0, 14.8), x0),
    }  # fmt: skip


def delay(prompt: Mask, late: Mask) -> dict[str, int]:
    """Return how Remark 5.2 uses what a delay of one slot has not brought; both masks (4, 7, 4)."""
    remark = prompt.copy()
    remark[:, 0] = False
    shifted = int((late[:, 1:] != np.roll(prompt, 1, axis=0)[:, :-1]).sum())
    return {"missing": int((remark & ~late).sum()), "shifted": shifted}


def any_order(plant: DelayedPlant, gains: Array, x0: Array) -> tuple[float, float]:
    """Return the bound of J by one Lyapunov matrix on the stacked state, and the largest J over the six cyclic orders."""
    columns = max(gains.shape[1], plant.memory + 1)
    X0 = np.concatenate([x0, np.zeros(len(x0) * (columns - 1))])
    bound, _ = common_bound(close(plant, gains), X0)
    worst = max(cost(close(plant, gains[list(order)]), start_at(x0, len(gains), 0)) for order in cyclic_orders(len(gains)))
    return bound, worst


def proof_numbers(plant: DelayedPlant, proof: BlockDiagonalProof, x0: Array) -> dict[str, Any]:
    """Return first and last bound of a scheme, how far its answer meets (5.9), and the largest J over the bound."""
    worst = max(cost(close(plant, proof.gains), start_at(x0, 4, phase)) for phase in range(4))
    return {
        "first": proof.bounds[0], "bound": proof.bounds[-1], "steps": len(proof.bounds) - 1, "worst": worst / proof.bounds[-1],
        "saved": proof.bounds[0] - proof.bounds[-1], "eigenvalue": largest_eigenvalue(plant, proof.gains, proof.P, proof.Q),
    }  # fmt: skip


# fmt: off
FURTHER = (
    Statement(
        "Remark 5.2: K(I(k), 0) = 0 covers a delay of one slot", "covers it",
        (exactly("samples that the remark uses before they have come", "missing", 0),),
        (
            above("samples that the remark uses before they have come", "missing", 0),
            exactly("entries in which the shifted mask of (5.8) is not what has come", "shifted", 0),
        ),
        basis="n = 4, m = 3: a delay shifts the whole mask, K(i, j) takes the place of K(i - 1, j - 1)",
    ),
    *(
        Statement(
            f"(5.18): an input weight, with the largest input of {name}", "-",
            (
                below("largest input less the printed one", f"more[{n}]", 1e-9),
                below("J, ours over the printed one", f"share[{n}]", 1),
            ),
            basis=f"I(0) = 1: weight {{matched[{n}].weight:.4g}}, largest input {{matched[{n}].peak:.4g}}, "
            f"J {{matched[{n}].cost:.4g}}; {name}: {{peaks[{n}]:.4g}}, {{J[{n}]:.4g}}",
        )
        for n, name in enumerate(("(5.16)", "(5.17)"))
    ),
    Statement(
        "(5.2): the order of the sensors is 1, 2, 3, 4", "not argued for",
        (below("mean cost of this order over that of the best", "order", 1.005),),
        basis="gains of least mean cost, m = 3, under each of the cyclic orders: {orders}",
    ),
    Statement(
        "(5.16) feels the noise of its sensors less than (5.17)", "-",
        (below("stationary cost of (5.16)", "noise[0]", "noise[1]"),),
        basis="standard deviation 0.1, a sample sent again keeps its noise: {noise[0]:.3g}, {noise[1]:.3g}; gains of least mean "
        "cost without noise {noise[2]:.3g}",
    ),
    Statement(
        "Theorem 5.1: one P for every phase, so for any order of the sensors", "bounded for any order",
        (above("bound of J by one P on the stacked state", "bound", "worst"),),
        basis="(5.16), inequalities checked at the returned P: bound {bound:.2f}; largest J of the six cyclic orders {worst:.2f}",
    ),
    Statement(
        "Theorem 5.1 on a plant that meets it", "-",
        (
            above("what the tangent scheme saves of the bound", "tangent[saved]", 0),
            below("largest eigenvalue of (5.9) at its answer", "tangent[eigenvalue]", 0),
            below("largest J over I(0), over the bound", "tangent[worst]", 1),
        ),
        basis="A(3,3) = 0.6, delayed matrices by 4: bound {tangent[first]:.3f} without gains, {tangent[bound]:.3f} with, "
        "after {tangent[steps]} steps",
    ),
    Statement(
        "Theorem 5.1 by cone complementarity, on a plant that meets it", "-",
        (
            below("bound of cone complementarity", "cone[bound]", 14.8),
            below("largest eigenvalue of (5.9), X the inverse of P", "cone[eigenvalue]", 0),
        ),
        basis="asked for 14.8: {cone[bound]:.3f}; the tangent scheme, asked for the least, {tangent[bound]:.3f}",
    ),
)
# fmt: on
