"""Chapter 5: every number and statement of the example of Section 5.4, beside what comes out; and what the chapter leaves open.

That is the input's price, the order of the sensors, any order, the theorem where it is feasible.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from design.as_printed.chapters_5_and_6 import historical_gains, newest_gains, printed_functional, stabilising_intervals
from design.historical_data import DelayedPlant, close
from design.historical_data.block_diagonal import (
    BlockDiagonalProof,
    common_bound,
    cone_complementarity,
    functional,
    largest_eigenvalue,
    tangent_scheme,
)
from design.historical_data.cost_bounds import arrivals_of, causal_bound
from design.historical_data.guaranteed_cost import average_start, certify_cost, cost, start_at, stationary_cost
from design.historical_data.least_cost import cyclic_orders, largest_input, match_peak, orders_by_cost, synthesise
from design.historical_data.sensor_schedule import Mask, mask_of, round_robin
from hil.compose import compose
from hil.experiment import load_experiment
from hil.pages import Figure, Series
from hil.runtime.virtual import simulate
from hil.thesis import Array, Chapter, Plot, ReportProgress, Stage
from hil.thesis.chapter5_equations import EQUATIONS, equations
from hil.thesis.statements import above, below, equal, exactly, says, statement
from plants.delayed_states import DelayedStates


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
    statement(
        "Remark 5.2: K(I(k), 0) = 0 covers a delay of one slot", "covers it",
        exactly("samples that the remark uses before they have come", "missing", 0),
        witness=(
            above("samples that the remark uses before they have come", "missing", 0),
            exactly("entries in which the shifted mask of (5.8) is not what has come", "shifted", 0),
        ),
        basis="n = 4, m = 3: a delay shifts the whole mask, K(i, j) takes the place of K(i - 1, j - 1)",
    ),
    *(
        statement(
            f"(5.18): an input weight, with the largest input of {name}", "-",
            below("largest input less the printed one", f"more[{n}]", 1e-9),
            below("J, ours over the printed one", f"share[{n}]", 1),
            basis=f"I(0) = 1: weight {{matched[{n}].weight:.4g}}, largest input {{matched[{n}].peak:.4g}}, "
            f"J {{matched[{n}].cost:.4g}}; {name}: {{peaks[{n}]:.4g}}, {{J[{n}]:.4g}}",
        )
        for n, name in enumerate(("(5.16)", "(5.17)"))
    ),
    statement(
        "(5.2): the order of the sensors is 1, 2, 3, 4", "not argued for",
        below("mean cost of this order over that of the best", "order", 1.005),
        basis="gains of least mean cost, m = 3, under each of the cyclic orders: {orders}",
    ),
    statement(
        "(5.16) feels the noise of its sensors less than (5.17)", "-",
        below("stationary cost of (5.16)", "noise[0]", "noise[1]"),
        basis="standard deviation 0.1, a sample sent again keeps its noise: {noise[0]:.3g}, {noise[1]:.3g}; gains of least mean "
        "cost without noise {noise[2]:.3g}",
    ),
    statement(
        "Theorem 5.1: one P for every phase, so for any order of the sensors", "bounded for any order",
        above("bound of J by one P on the stacked state", "bound", "worst"),
        basis="(5.16), inequalities checked at the returned P: bound {bound:.2f}; largest J of the six cyclic orders {worst:.2f}",
    ),
    statement(
        "Theorem 5.1 on a plant that meets it", "-",
        above("what the tangent scheme saves of the bound", "tangent[saved]", 0),
        below("largest eigenvalue of (5.9) at its answer", "tangent[eigenvalue]", 0),
        below("largest J over I(0), over the bound", "tangent[worst]", 1),
        basis="A(3,3) = 0.6, delayed matrices by 4: bound {tangent[first]:.3f} without gains, {tangent[bound]:.3f} with, "
        "after {tangent[steps]} steps",
    ),
    statement(
        "Theorem 5.1 by cone complementarity, on a plant that meets it", "-",
        below("bound of cone complementarity", "cone[bound]", 14.8),
        below("largest eigenvalue of (5.9), X the inverse of P", "cone[eigenvalue]", 0),
        basis="asked for 14.8: {cone[bound]:.3f}; the tangent scheme, asked for the least, {tangent[bound]:.3f}",
    ),
)
# fmt: on
SLOTS = 100


def published_plant() -> DelayedPlant:
    """Return the plant of Section 5.4."""
    plant = DelayedStates()
    model = plant.model()
    return DelayedPlant(A=model.A, delayed=plant.state_delays(), B=model.B, weight=plant.cost_weights()[0])


def costs(plant: DelayedPlant, gains: Array) -> list[float]:
    """Return J from the chapter's x(0) for I(0) = 1, 2, 3, 4."""
    loop, x0 = close(plant, gains), DelayedStates().initial_state
    return [cost(loop, start_at(x0, 4, phase)) for phase in range(4)]


def gains_numbers(plant: DelayedPlant, historical: Array, newest: Array) -> dict[str, Any]:
    """Return the numbers of the printed gains (5.16) and (5.17)."""
    ours, theirs = costs(plant, historical), costs(plant, newest)
    idle = costs(plant, 0.0 * newest)[0]
    return {
        "stray": float(np.abs(historical[:, :, 0][~mask_of(round_robin(4, buffer=3))]).max()),
        "used": float(np.count_nonzero(historical)), "J": ours, "alike": sum(f"{J:.1f}" == "220.2" for J in ours),
        "certificate": certify_cost(plant, historical, average_start(4, 4)).state, "less": ours[1] - theirs[1],
        "least": min(ours) - max(theirs), "gain": 1.0 - ours[1] / idle, "idle": idle,
        "ours": ", ".join(f"{J:.3f}" for J in ours), "theirs": ", ".join(f"{J:.3f}" for J in theirs),
    }  # fmt: skip


def theorem_numbers(plant: DelayedPlant) -> dict[str, Any]:
    """Return the numbers of Theorem 5.1 and its functional."""
    history = [np.array([value]) for value in (0.0, 0.0, 0.0, 1.0)]
    P, Q = np.array([[5.6]]), np.array([[[1e-6]], [[1e-6]], [[4.0]]])
    x, total = [float(h[0]) for h in history], 0.0
    for _ in range(500):
        total += x[0] ** 2
        x = [0.1 * x[0] + 0.8 * x[3], *x[:3]]
    return {
        "schur": sum(bool(stabilising_intervals(plant.A, plant.B, state)) for state in range(4)),
        "radius": min(_least_radius(plant, state) for state in (0, 1, 3)),
        "printed": printed_functional(P, Q, history) - total, "right": functional(P, Q, history) - total,
    }  # fmt: skip


def _least_radius(plant: DelayedPlant, state: int) -> float:
    e = np.eye(len(plant.A))[state : state + 1]
    return min(float(np.abs(np.linalg.eigvals(plant.A + k * plant.B @ e)).max()) for k in np.linspace(-60.0, 60.0, 2401))


def history_numbers(plant: DelayedPlant) -> dict[str, Any]:
    """Return what historical data are worth once the gains are optimal."""
    start, nodes = average_start(4, 4), round_robin(4, buffer=3)
    full, arrivals = mask_of(nodes), arrivals_of(nodes)
    newest = full & (np.arange(6) == 0)[None, :, None]
    return {
        "mean": [cost(close(plant, synthesise(plant, mask, start)), start) for mask in (full, newest)],
        "printed": [cost(close(plant, gains), start) for gains in (historical_gains(), newest_gains())],
        "bound": np.nan if arrivals is None else causal_bound(plant, arrivals, start.moment),
    }


def figures() -> dict[str, Any]:
    """Return Figures 5.3 and 5.4 from runs on the rig, and what the text reads from them."""
    runs, panels = {}, []
    for number, name in (("5.3", "newest"), ("5.4", "published")):
        loop = compose(load_experiment(f"multisensor-{name}", [f"duration={SLOTS * 0.05}"]))
        states = simulate(loop, loop.experiment.seed).arrays["/plant/state"]
        x = runs[number] = np.column_stack([states[f"x{i + 1}"] for i in range(4)])
        series = tuple(Series(label=f"x{i + 1}", x=np.arange(SLOTS), y=x[:, i], colour=i) for i in range(4))
        panels.append(Figure(title=f"{number}: {name} gains", series=series, x_label="k", x_unit="", y_label="x"))
    rough = {number: np.abs(np.diff(x, 2, axis=0)).sum(axis=0) for number, x in runs.items()}
    ratios = rough["5.4"] / rough["5.3"]
    return {
        "figures": (Plot(title="Figures 5.3 and 5.4", panels=tuple(panels)),), "ratios": ratios,
        "rough": rough["5.4"].sum() / rough["5.3"].sum(), "later": _settled(runs["5.4"]) - _settled(runs["5.3"]),
        "x2_x4": max(ratios[[1, 3]]), "x1_x3": min(ratios[[0, 2]]),
    }  # fmt: skip


def _settled(x: Array) -> float:
    outside = np.flatnonzero(np.abs(x).max(axis=1) > 0.02 * np.abs(x[0]).max())
    return float(outside[-1] + 1) if len(outside) else 0.0


# fmt: off
GAINS = (
    statement(
        "(5.16): zero-element constraints (5.8)", "hold",
        exactly("largest forbidden entry", "stray", 0, 1e-12), exactly("entries used", "used", 60),
        basis="n = 4, m = 3, tau = 5",
    ),
    statement(
        "J of (5.16)", "220.2",
        equal("J for I(0) = 2", "J[1]", "220.2"), exactly("number of I(0) whose J is 220.2", "alike", 1),
        basis="I(0) is not stated; exact, by the periodic Lyapunov equation on the stacked state: J for I(0) = 1 to 4: {ours}",
    ),
    statement(
        "the proposed controller stabilises the plant", "yes", says("the certificate", "certificate", "certified"),
        basis="growth of |X|^2 on the stacked state",
    ),
    statement(
        "5.5: the proposed controller outperforms the conventional technique", "outperforms (5.17)",
        below("J of (5.16) for I(0) = 2, less that of (5.17),", "less", 0),
        witness=(
            above("least J of (5.16) over I(0), less the largest of (5.17),", "least", 0),
            below("gain over no control at all, as a share of J,", "gain", 0.05),
        ),
        basis="(5.17) costs {theirs} for I(0) = 1, 2, 3, 4, no control {idle:.3f}; in smoothness and peak input (5.16) is the "
        "better one",
    ),
)
THEOREM = (
    statement(
        "Theorem 5.1: a bound V(x(0)) = 616.5 for Section 5.4", "feasible",
        exactly("sensors whose A + B K(i, 0) can be Schur, as (5.9) needs,", "schur", 4),
        witness=(
            below("sensors for which some K(i, 0) makes it Schur", "schur", 4),
            above("least spectral radius over all K(i, 0) of the others", "radius", 1),
        ),
        basis="the mask leaves one number in K(i, 0); exact for the count, over 2401 numbers for the radius",
    ),
    statement(
        "(5.15): J < V(x(0)) with any history", "holds", above("printed V less J", "printed", 0),
        witness=(below("printed V less J", "printed", 0), above("V with the sum from h = -j, less J,", "right", 0)),
        basis="x(k+1) = 0.1 x(k) + 0.8 x(k-3) after (0, 0, 0, 1): the printed sum pairs Q_j with the lag tau + 1 - j",
    ),
)
HISTORY = (
    statement(
        "historical data make a better controller", "yes", below("mean cost with history", "mean[0]", "mean[1]"),
        basis="gains of least mean cost, x(0) ~ N(0, I); newest sample only {mean[1]:.4f}, no causal controller goes below "
        "{bound:.4f}; printed gains {printed[0]:.4f} and {printed[1]:.4f}",
    ),
)
FIGURES = (
    statement(
        "Figures 5.3, 5.4: the proposed controller is smoother", "yes",
        below("sum of second differences, (5.16) over (5.17),", "rough", 1), basis="I(0) = 2, on the rig",
    ),
    statement(
        "Figures 5.3, 5.4: smoother especially in x2 and x4", "yes",
        below("larger ratio of x2 and x4, beside the smaller one of x1 and x3,", "x2_x4", "x1_x3"),
        basis="sum of second differences, (5.16) over (5.17), of x1 to x4: {ratios[0]:.3f}, {ratios[1]:.3f}, {ratios[2]:.3f}, "
        "{ratios[3]:.3f}",
    ),
    statement(
        "Figures 5.3, 5.4: the proposed controller settles later", "yes",
        above("slots to 2 %, (5.16) less (5.17),", "later", 0), basis="I(0) = 2, on the rig",
    ),
)
CHAPTER = Chapter(
    title="Chapter 5: guaranteed cost control from historical data",
    stages=(
        Stage("equations", lambda report: equations(published_plant()), 3, EQUATIONS),
        Stage("printed gains", lambda report: gains_numbers(published_plant(), historical_gains(), newest_gains()), 0.1, GAINS),
        Stage("Theorem 5.1", lambda report: theorem_numbers(published_plant()), 0.3, THEOREM),
        Stage("history", lambda report: history_numbers(published_plant()), 0.5, HISTORY),
        Stage("further", lambda report: further(published_plant(), report), 8, FURTHER),
        Stage("runs", lambda report: figures(), 0.3, FIGURES),
    ),
)
# fmt: on
