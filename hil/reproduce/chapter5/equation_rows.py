"""Chapter 5, equation by equation: the schedule, the loop and its constraints as the rig has them, and what is said of them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from design.as_printed.historical_data import historical_gains, newest_gains
from design.historical_data.guaranteed_cost import average_start, certify_cost, cost, synthesise
from design.historical_data.information import Information, Mask, round_robin
from design.historical_data.lifted_loop import DelayedPlant, close, cycle
from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.log.run import Run
from hil.measure.cost import Cost
from hil.measure.view import view_of
from hil.reproduce.judgement import Row, above, below, near, row, says
from hil.session import simulate
from plants.delayed_states import DelayedStates
from transport.medium.draws import DELIVERED

Array = npt.NDArray[np.float64]
SLOTS = 400

PRINTED_MASK = ("00*0", "0**0", "***0", "**0*", "*0**", "0***")
"""(5.8): K(3, 0) to K(3, 5), as printed."""

EARLIER = ((1, 5), (2, 5), (2, 4))
"""Remark 5.1: x2(k-5), x3(k-5) and x3(k-4), which earlier packets brought; (state, j) counted from 0."""


def equation_rows(plant: DelayedPlant) -> list[Row]:
    """Return all rows of this stage."""
    loop = compose(load_experiment("multisensor-published", [f"duration={SLOTS * 0.05}"]))
    run = simulate(loop, 0)
    spent = Cost().of(view_of(run, loop.experiment))["cost"]
    heard, states = who_was_heard(run), np.column_stack([run.arrays["/plant/state"][f"x{i + 1}"] for i in range(4)])
    info, current = round_robin(4, buffer=3), cycle(4)
    return [
        schedule_row(heard), loop_row(plant, historical_gains(), states), rig_cost_row(spent), memory_row(info),
        mask_row(info.mask()[2]), earlier_row(info), shape_row(historical_gains()), path_row(current),
        plant_row(plant), conventional_row(plant, newest_gains()),
        random_row(*random_gains(plant)),
    ]  # fmt: skip


def who_was_heard(run: Run) -> list[int]:
    """Return the node whose packet came in each slot of a run, from 0; -1 for none."""
    draws = run.arrays["/network/sc"]
    found = [-1] * len(run.arrays["/plant/state"])
    for slot, node, reason in zip(draws["tick"].tolist(), draws["node"].tolist(), draws["reason"].tolist()):
        if reason == DELIVERED:
            found[slot] = node
    return found


def schedule_row(heard: Sequence[int]) -> Row:
    """Return the row on (5.2): the node that the controller hears in each slot of a run."""
    wrong = sum(b != (a + 1) % 4 for a, b in pairwise(heard))
    return row(
        "(5.2): the sensors send one after the other", "I(k+1) = I(k) + 1, after n comes 1",
        near("slots of a run in which another node is heard", wrong, 0.0), basis=f"{len(heard)} slots on the rig, I(0) = 2",
    )  # fmt: skip


def loop_row(plant: DelayedPlant, gains: Array, states: Array) -> Row:
    """Return the row on (5.5) to (5.7): the recursion beside a run, whose packets carry float32."""
    past, worst = [np.zeros(4)] * gains.shape[1], 0.0
    x = states[0]
    for k, measured in enumerate(states):
        worst = max(worst, float(np.abs(x - measured).max()))
        past = [x, *past[:-1]]
        Ac = [matrix + plant.B @ K for matrix, K in zip((plant.A, *plant.delayed), gains[(1 + k) % 4], strict=True)]
        x = sum((matrix @ old for matrix, old in zip(Ac, past, strict=True)), np.zeros(4))
    return row(
        "(5.1), (5.4)-(5.7): x(k+1) = A_c0(I) x(k) + sum of A_cj(I) x(k-j)", "the closed loop",
        below("largest difference between a run and (5.5)", worst, 1e-5),
        basis=f"{len(states)} slots, I(0) = 2; samples and inputs travel as float32",
    )  # fmt: skip


def rig_cost_row(spent: float | None) -> Row:
    """Return the row on (5.3) as a run counts it."""
    return row(
        "(5.3): J of a run under (5.16)", "220.2", near("J of a run", np.nan if spent is None else spent, 220.2, absolute=0.05),
        basis=f"I(0) = 2, {SLOTS} slots on the rig; what follows them is below 1e-9",
    )  # fmt: skip


def memory_row(info: Information) -> Row:
    """Return the row on m = tau - n + 2: the oldest sample of the first full cycle."""
    oldest = max(info.phases - 1 + info.buffer - 1, 0)
    return row(
        "m = tau - n + 2", "m = 3 for n = 4, tau = 5",
        near("oldest sample that the packets of one cycle bring", oldest, 5.0),
        near("m", info.memory - info.phases + 2, info.buffer), basis="the packet of n - 1 slots ago, its m-th sample",
    )  # fmt: skip


def mask_row(mask: npt.NDArray[np.bool_]) -> Row:
    """Return the row on (5.8); the mask (6, 4) is that of I(k) = 3."""
    printed = np.array([[c == "*" for c in line] for line in PRINTED_MASK])
    return row(
        "(5.8): the zero elements of K(3, 0), ..., K(3, 5)", "24 entries",
        near("entries that differ from what the packets bring", int((printed != mask).sum()), 0.0),
        near("free entries", int(mask.sum()), 15.0), basis="n = 4, m = 3, from the schedule (5.2)",
    )  # fmt: skip


def earlier_row(info: Information) -> Row:
    """Return the row on Remark 5.1: three samples that are known from earlier packets."""
    known = info.mask()[2]
    only = np.zeros_like(known)  # what the newest packet of each node brings, and nothing before
    for state in range(4):
        age = (2 - state) % 4
        only[age : age + info.buffer, state] = True
    return row(
        "Remark 5.1: x2(k-5), x3(k-5) and x3(k-4) come from earlier packets", "accessible",
        near("of the three, known", sum(bool(known[j, l]) for l, j in EARLIER), 3.0),
        near("of the three, in the last four packets", sum(bool(only[j, l]) for l, j in EARLIER), 0.0), basis="I(k) = 3",
    )  # fmt: skip


def shape_row(gains: Array) -> Row:
    """Return the row on the size of the controller's matrices."""
    rows, columns = gains.shape[2:]
    return row(
        "the controller has 24 n x 1 matrices", "24 of 4 x 1",
        near("matrices", len(gains) * gains.shape[1], 24.0), near("rows of each", rows, 4.0),
        witness=(near("rows of each", rows, 1.0), near("columns of each", columns, 4.0)),
        basis="u = K x with p = 1 input: K(i, j) is p x n; the same in Remark 5.2",
    )  # fmt: skip


def path_row(transition: Array) -> Row:
    """Return the row on Remark 5.3: the transition matrix of I(k), and how many paths it leaves."""
    return row(
        "Remark 5.3: Lambda; every possible path is to be tested, so one P for all i", "one P for every i",
        above("paths of I(k) from a given I(0)", float((transition > 0).sum(axis=1).max()), 1.0),
        witness=(
            near("paths of I(k) from a given I(0)", float((transition > 0).sum(axis=1).max()), 1.0),
            near("entries of Lambda that are not the cycle's", float((transition != np.roll(np.eye(4), 1, axis=1)).sum()), 0.0),
        ),
        basis="from each I(0) there is one path: a P(i) for each phase suffices, and on the stacked state it is necessary too",
    )  # fmt: skip


def plant_row(plant: DelayedPlant) -> Row:
    """Return the row on the sizes and the weight of Section 5.4."""
    x0 = DelayedStates().initial_state
    return row(
        "5.4: n = 4, p = 1, tau = 5, Xi = 0.1 I, x(0) = (-4, 3, -6, 1)", "as printed",
        near("n", len(plant.A), 4.0), near("p", plant.B.shape[1], 1.0), near("tau", plant.memory, 5.0),
        near("largest entry of Xi - 0.1 I", float(np.abs(plant.weight - 0.1 * np.eye(len(plant.A))).max()), 0.0, absolute=1e-12),
        near("largest entry of x(0) - (-4, 3, -6, 1)", float(np.abs(np.subtract(x0, (-4, 3, -6, 1))).max()), 0.0),
        basis="the plant `delayed-states`, which every experiment of the chapter runs",
    )  # fmt: skip


def conventional_row(plant: DelayedPlant, gains: Array) -> Row:
    """Return the row on the stability of the comparison's controller."""
    return row(
        "Figures 5.3, 5.4: both controllers stabilise the plant", "yes",
        says("the certificate of (5.17)", certify_cost(plant, gains, average_start(4, 4)).state, "certified"),
        basis="growth of |X|^2 on the stacked state; (5.16) has a row of its own",
    )  # fmt: skip


def random_gains(plant: DelayedPlant) -> tuple[float, float]:
    """Return growth of E|X|^2 and mean cost under gains of the current packet, m = 3, over independent uniform turns."""
    chain, start = np.full((4, 4), 0.25), average_start(4, 4)
    mask: Mask = np.zeros((4, 3, 4), dtype=bool)
    for node in range(4):
        mask[node, :, node] = True
    loop = close(plant, synthesise(plant, mask, start, transition=chain), chain)
    return loop.radius(), cost(loop, start)


def random_row(radius: float, mean_cost: float) -> Row:
    """Return the row on a stochastic schedule; see `random_gains`."""
    return row(
        "5.5: a stochastic schedule needs a controller that is stochastically stable", "further research",
        below("growth of E|X|^2 per slot", radius, 1.0), below("mean cost", mean_cost, 2.385),
        basis="turns independent and uniform, gains of the current packet of 3 samples, x(0) ~ N(0, I)",
    )  # fmt: skip
