"""Chapter 5: every number and statement of the example of Section 5.4, beside what comes out."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from design.as_printed.guaranteed_cost import printed_functional, stabilising_intervals
from design.as_printed.historical_data import historical_gains, newest_gains
from design.historical_data.block_diagonal import functional
from design.historical_data.cost_bounds import lower_bounds
from design.historical_data.guaranteed_cost import average_start, certify_cost, cost, start_at, synthesise
from design.historical_data.information import round_robin
from design.historical_data.lifted_loop import DelayedPlant, close
from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.report.html.figures import Figure, Series
from hil.reproduce.chapter import Chapter, Part, Plot, ReportProgress, Stage
from hil.reproduce.chapter5.equation_rows import equation_rows
from hil.reproduce.chapter5.further import further_rows
from hil.reproduce.judgement import Row, above, below, near, row, says
from hil.session import simulate
from plants.delayed_states import DelayedStates

Array = npt.NDArray[np.float64]
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


def _gains(report_progress: ReportProgress) -> Part:
    return Part(rows=tuple(cost_rows(published_plant(), historical_gains(), newest_gains())))


def _theorem(report_progress: ReportProgress) -> Part:
    return Part(rows=tuple(theorem_rows(published_plant())))


def _ours(report_progress: ReportProgress) -> Part:
    return Part(rows=tuple(history_rows(published_plant())))


def _further(report_progress: ReportProgress) -> Part:
    return Part(rows=tuple(further_rows(published_plant(), report_progress)))


def _equations(report_progress: ReportProgress) -> Part:
    return Part(rows=tuple(equation_rows(published_plant())))


def _runs(report_progress: ReportProgress) -> Part:
    return figures()


def cost_rows(plant: DelayedPlant, historical: Array, newest: Array) -> list[Row]:
    """Return the rows on the printed gains (5.16) and (5.17)."""
    ours, theirs = costs(plant, historical), costs(plant, newest)
    idle = costs(plant, 0.0 * newest)[0]
    mask = round_robin(4, buffer=3).mask()
    stray = float(np.abs(historical[:, :, 0][~mask]).max())
    rows = [
        row(
            "(5.16): zero-element constraints (5.8)", "hold",
            near("largest forbidden entry", stray, 0.0, absolute=1e-12),
            near("entries used", float(np.count_nonzero(historical)), 60.0), basis="n = 4, m = 3, tau = 5",
        ),
        row(
            "J of (5.16)", "220.2", near("J for I(0) = 2", ours[1], 220.2, absolute=0.05),
            basis="I(0) is not stated; exact, by the periodic Lyapunov equation on the stacked state",
        ),
        row(
            "the proposed controller stabilises the plant", "yes",
            says("the certificate", certify_cost(plant, historical, average_start(4, 4)).state, "certified"),
            basis="growth of |X|^2 on the stacked state",
        ),
        row(
            "5.5: the proposed controller outperforms the conventional technique", "outperforms (5.17)",
            below("J of (5.16) for I(0) = 2, less that of (5.17),", ours[1] - theirs[1], 0.0),
            witness=(
                above("least J of (5.16) over I(0), less the largest of (5.17),", min(ours) - max(theirs), 0.0),
                below("gain over no control at all, as a share of J,", 1.0 - ours[1] / idle, 0.05),
            ),
            basis=f"(5.17) costs {', '.join(f'{J:.3f}' for J in theirs)} for I(0) = 1, 2, 3, 4, no control {idle:.3f}; "
            "in smoothness and peak input (5.16) is the better one",
        ),
    ]  # fmt: skip
    said = ", ".join(f"{J:.3f}" for J in ours)
    alike = sum(abs(J - 220.2) <= 0.05 for J in ours)
    rows.append(
        row(
            "I(0) of J = 220.2", "not stated", near("number of I(0) whose J is 220.2", alike, 1.0),
            basis=f"J for I(0) = 1, 2, 3, 4: {said}; the four printed decimals of the gains move J by at most 0.05",
        )
    )  # fmt: skip
    return rows


def theorem_rows(plant: DelayedPlant) -> list[Row]:
    """Return the rows on Theorem 5.1 and its functional."""
    with_gain = [bool(stabilising_intervals(plant.A, plant.B, state)) for state in range(4)]
    least = [_least_radius(plant, state) for state in (0, 1, 3)]
    history = [np.array([value]) for value in (0.0, 0.0, 0.0, 1.0)]
    P, Q = np.array([[5.6]]), np.array([[[1e-6]], [[1e-6]], [[4.0]]])
    x, total = [float(h[0]) for h in history], 0.0
    for _ in range(500):
        total += x[0] ** 2
        x = [0.1 * x[0] + 0.8 * x[3], *x[:3]]
    return [
        row(
            "Theorem 5.1: a bound V(x(0)) = 616.5 for Section 5.4", "feasible",
            near("sensors whose A + B K(i, 0) can be Schur, as (5.9) needs,", float(sum(with_gain)), 4.0),
            witness=(
                below("sensors for which some K(i, 0) makes it Schur", float(sum(with_gain)), 4.0),
                above("least spectral radius over all K(i, 0) of the others", min(least), 1.0),
            ),
            basis="the mask leaves one number in K(i, 0); exact for the count, over 2401 numbers for the radius",
        ),
        row(
            "(5.15): J < V(x(0)) with any history", "holds",
            above("printed V less J", printed_functional(P, Q, history) - total, 0.0),
            witness=(
                below("printed V less J", printed_functional(P, Q, history) - total, 0.0),
                above("V with the sum from h = -j, less J,", functional(P, Q, history) - total, 0.0),
            ),
            basis="x(k+1) = 0.1 x(k) + 0.8 x(k-3) after (0, 0, 0, 1): the printed sum pairs Q_j with the lag tau + 1 - j",
        ),
    ]  # fmt: skip


def _least_radius(plant: DelayedPlant, state: int) -> float:
    e = np.eye(len(plant.A))[state : state + 1]
    return min(float(np.abs(np.linalg.eigvals(plant.A + k * plant.B @ e)).max()) for k in np.linspace(-60.0, 60.0, 2401))


def history_rows(plant: DelayedPlant) -> list[Row]:
    """Return the rows on what historical data are worth once the gains are optimal."""
    start, full = average_start(4, 4), round_robin(4, buffer=3)
    newest = full.mask() & (np.arange(6) == 0)[None, :, None]
    values = [cost(close(plant, synthesise(plant, mask, start)), start) for mask in (full.mask(), newest)]
    printed = [cost(close(plant, gains), start) for gains in (historical_gains(), newest_gains())]
    bound = lower_bounds(plant, full, start).causal
    return [
        row(
            "historical data make a better controller", "yes",
            below("mean cost with history", values[0], values[1]), below("mean cost with history", values[0], 1.8130),
            below("share above the bound of any causal controller", values[0] / bound - 1.0, 0.031),
            basis=f"gains of least mean cost, x(0) ~ N(0, I); newest sample only {values[1]:.4f}, bound {bound:.4f}; "
            f"printed gains {printed[0]:.4f} and {printed[1]:.4f}",
        ),
    ]  # fmt: skip


def figures() -> Part:
    """Return Figures 5.3 and 5.4 from runs on the rig, and what the text reads from them."""
    runs, panels = {}, []
    for number, name in (("5.3", "newest"), ("5.4", "published")):
        loop = compose(load_experiment(f"multisensor-{name}", [f"duration={SLOTS * 0.05}"]))
        states = simulate(loop, 0).arrays["/plant/state"]
        x = runs[number] = np.column_stack([states[f"x{i + 1}"] for i in range(4)])
        series = tuple(Series(label=f"x{i + 1}", x=np.arange(SLOTS), y=x[:, i], colour=i) for i in range(4))
        panels.append(Figure(title=f"{number}: {name} gains", series=series, x_label="k", x_unit="", y_label="x"))
    rough = {number: np.abs(np.diff(x, 2, axis=0)).sum(axis=0) for number, x in runs.items()}
    ratios = rough["5.4"] / rough["5.3"]
    settled = {number: _settled(x) for number, x in runs.items()}
    rows = (
        row(
            "Figures 5.3, 5.4: the proposed controller is smoother", "yes",
            below("sum of second differences, (5.16) over (5.17),", rough["5.4"].sum() / rough["5.3"].sum(), 1.0),
            basis="I(0) = 2, on the rig",
        ),
        especially_row(ratios),
        row(
            "Figures 5.3, 5.4: the proposed controller settles later", "yes",
            above("slots to 2 %, (5.16) less (5.17),", settled["5.4"] - settled["5.3"], 0.0), basis="I(0) = 2, on the rig",
        ),
    )  # fmt: skip
    return Part(rows=rows, figures=(Plot(title="Figures 5.3 and 5.4", panels=tuple(panels)),))


def especially_row(ratios: Array) -> Row:
    """Return the row on the states that gain most; ``ratios`` (4,) are sums of second differences, (5.16) over (5.17)."""
    return row(
        "Figures 5.3, 5.4: smoother especially in x2 and x4", "yes",
        below("larger ratio of x2 and x4, less the smaller one of x1 and x3,", max(ratios[[1, 3]]) - min(ratios[[0, 2]]), 0.0),
        basis=f"sum of second differences, (5.16) over (5.17), of x1 to x4: {', '.join(f'{r:.3f}' for r in ratios)}",
    )  # fmt: skip


def _settled(x: Array) -> float:
    outside = np.flatnonzero(np.abs(x).max(axis=1) > 0.02 * np.abs(x[0]).max())
    return float(outside[-1] + 1) if len(outside) else 0.0


CHAPTER = Chapter(
    title="Chapter 5: guaranteed cost control from historical data",
    stages=(
        Stage("equations", _equations, 3), Stage("printed gains", _gains, 0.1),
        Stage("Theorem 5.1", _theorem, 0.3), Stage("history", _ours, 0.5),
        Stage("further", _further, 8), Stage("runs", _runs, 0.3),
    ),
)
