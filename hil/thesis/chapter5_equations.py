"""Chapter 5, equation by equation: the schedule, the loop and its constraints as the rig has them, and what is said of them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from design.as_printed.chapters_5_and_6 import historical_gains, newest_gains
from design.historical_data import DelayedPlant, close, cycle
from design.historical_data.guaranteed_cost import average_start, certify_cost, cost, start_at
from design.historical_data.least_cost import synthesise
from design.historical_data.sensor_schedule import Mask, mask_of, round_robin
from hil.compose import compose
from hil.experiment import load_experiment
from hil.log.run import Run
from hil.measure.cost import Cost
from hil.measure.view import view_of
from hil.runtime.virtual import simulate
from hil.thesis import Array
from hil.thesis.statements import above, below, exactly, says, statement
from plants.delayed_states import DelayedStates
from transport.draws import DELIVERED

SLOTS = 400

PRINTED_MASK = ("00*0", "0**0", "***0", "**0*", "*0**", "0***")
"""(5.8): K(3, 0) to K(3, 5), as printed."""

EARLIER = ((1, 5), (2, 5), (2, 4))
"""Remark 5.1: x2(k-5), x3(k-5) and x3(k-4), which earlier packets brought; (state, j) counted from 0."""


def equations(plant: DelayedPlant) -> dict[str, Any]:
    """Return the numbers of this stage."""
    loop = compose(load_experiment("multisensor-published", [f"duration={SLOTS * 0.05}"]))
    run = simulate(loop, loop.experiment.seed)
    spent = Cost().of(view_of(run, loop.experiment))["cost"]
    states = np.column_stack([run.arrays["/plant/state"][f"x{i + 1}"] for i in range(4)])
    gains, nodes, current = historical_gains(), round_robin(4, buffer=3), cycle(4)
    mask, buffer = mask_of(nodes), nodes.buffers[0]
    received = received_nodes(run)
    start, x0 = average_start(4, 4), DelayedStates().initial_state
    radius, mean_cost = random_gains(plant)
    return {
        "received": len(received), "wrong": wrong_turns(received), "loop": loop_difference(plant, gains, states),
        "spent": np.nan if spent is None else spent, "exact": cost(close(plant, gains), start_at(x0, 4, 1)),
        "oldest": max(len(mask) - 1 + buffer - 1, 0), "m": mask.shape[1] - len(mask) + 1, "buffer": buffer,
        **mask_numbers(mask[2], buffer), "matrices": len(gains) * gains.shape[1], "shape": gains.shape[2:],
        "paths": float((current > 0).sum(axis=1).max()), "strange": float((current != np.roll(np.eye(4), 1, axis=1)).sum()),
        "n": len(plant.A), "p": plant.B.shape[1], "tau": plant.memory, "weight": 0.1,
        "xi": float(np.abs(plant.weight - 0.1 * np.eye(len(plant.A))).max()),
        "x0": float(np.abs(np.subtract(x0, (-4, 3, -6, 1))).max()),
        "newest": certify_cost(plant, newest_gains(), start).state, "random_radius": radius, "random_cost": mean_cost,
    }  # fmt: skip


def received_nodes(run: Run) -> list[int]:
    """Return the node whose packet came in each slot of a run, from 0; -1 for none."""
    draws = run.arrays["/network/sc"]
    found = [-1] * len(run.arrays["/plant/state"])
    for slot, node, reason in zip(draws["slot"].tolist(), draws["node"].tolist(), draws["reason"].tolist()):
        if reason == DELIVERED:
            found[slot] = node
    return found


def wrong_turns(received: Sequence[int]) -> int:
    """Return the slots after which another node than the next one of (5.2) is received."""
    return sum(b != (a + 1) % 4 for a, b in pairwise(received))


def loop_difference(plant: DelayedPlant, gains: Array, states: Array) -> float:
    """Return the largest difference of the recursion (5.5) to (5.7) from a run, whose packets carry float32."""
    past, worst = [np.zeros(4)] * gains.shape[1], 0.0
    x = states[0]
    for k, measured in enumerate(states):
        worst = max(worst, float(np.abs(x - measured).max()))
        past = [x, *past[:-1]]
        Ac = [matrix + plant.B @ K for matrix, K in zip((plant.A, *plant.delayed), gains[(1 + k) % 4], strict=True)]
        x = sum((matrix @ old for matrix, old in zip(Ac, past, strict=True)), np.zeros(4))
    return worst


def mask_numbers(mask: npt.NDArray[np.bool_], buffer: int) -> dict[str, int]:
    """Return what (5.8) and Remark 5.1 are judged by; the mask (6, 4) is that of I(k) = 3."""
    printed = np.array([[c == "*" for c in line] for line in PRINTED_MASK])
    only = np.zeros_like(mask)  # what the newest packet of each node brings, and nothing before
    for state in range(4):
        age = (2 - state) % 4
        only[age : age + buffer, state] = True
    return {
        "differ": int((printed != mask).sum()), "free": int(mask.sum()),
        "known": sum(bool(mask[j, l]) for l, j in EARLIER), "late": sum(bool(only[j, l]) for l, j in EARLIER),
    }  # fmt: skip


def random_gains(plant: DelayedPlant) -> tuple[float, float]:
    """Return growth of E|X|^2 and mean cost under gains of the current packet, m = 3, over independent uniform turns."""
    chain, start = np.full((4, 4), 0.25), average_start(4, 4)
    mask: Mask = np.zeros((4, 3, 4), dtype=bool)
    for node in range(4):
        mask[node, :, node] = True
    loop = close(plant, synthesise(plant, mask, start, transition=chain), chain)
    return loop.radius(), cost(loop, start)


# fmt: off
EQUATIONS = (
    statement(
        "(5.2): the sensors send one after the other", "I(k+1) = I(k) + 1, after n comes 1",
        exactly("slots of a run in which another node is received", "wrong", 0), basis="{received} slots on the rig, I(0) = 2",
    ),
    statement(
        "(5.1), (5.4)-(5.7): x(k+1) = A_c0(I) x(k) + sum of A_cj(I) x(k-j)", "the closed loop",
        exactly("largest difference between a run and (5.5)", "loop", 0, 1e-5),
        basis=f"{SLOTS} slots, I(0) = 2; samples and inputs travel as float32",
    ),
    statement(
        "(5.3): a run under (5.16) costs the J of the stacked state", "sum of x' Xi x",
        exactly("J of a run", "spent", "exact", 1e-4),
        basis=f"I(0) = 2, {SLOTS} slots on the rig; what follows them is below 1e-9; samples and inputs travel as float32",
    ),
    statement(
        "m = tau - n + 2", "m = 3 for n = 4, tau = 5",
        exactly("oldest sample that the packets of one cycle bring", "oldest", 5), exactly("m", "m", "buffer"),
        basis="the packet of n - 1 slots ago, its m-th sample",
    ),
    statement(
        "(5.8): the zero elements of K(3, 0), ..., K(3, 5)", "24 entries",
        exactly("entries that differ from what the packets bring", "differ", 0), exactly("free entries", "free", 15),
        basis="n = 4, m = 3, from the schedule (5.2)",
    ),
    statement(
        "Remark 5.1: x2(k-5), x3(k-5) and x3(k-4) come from earlier packets", "accessible",
        exactly("of the three, known", "known", 3), exactly("of the three, in the last four packets", "late", 0),
        basis="I(k) = 3",
    ),
    statement(
        "the controller has 24 n x 1 matrices", "24 of 4 x 1",
        exactly("matrices", "matrices", 24), exactly("rows of each", "shape[0]", 4),
        witness=(exactly("rows of each", "shape[0]", 1), exactly("columns of each", "shape[1]", 4)),
        basis="u = K x with p = 1 input: K(i, j) is p x n; the same in Remark 5.2",
    ),
    statement(
        "Remark 5.3: Lambda; every possible path is to be tested, so one P for all i", "one P for every i",
        above("paths of I(k) from a given I(0)", "paths", 1),
        witness=(
            exactly("paths of I(k) from a given I(0)", "paths", 1),
            exactly("entries of Lambda that are not the cycle's", "strange", 0),
        ),
        basis="from each I(0) there is one path: a P(i) for each phase suffices, and on the stacked state it is necessary too",
    ),
    statement(
        "5.4: n = 4, p = 1, tau = 5, Xi = 0.1 I, x(0) = (-4, 3, -6, 1)", "as printed",
        exactly("n", "n", 4), exactly("p", "p", 1), exactly("tau", "tau", 5),
        exactly("largest entry of Xi - 0.1 I", "xi", 0, 1e-12, "weight"),
        exactly("largest entry of x(0) - (-4, 3, -6, 1)", "x0", 0),
        basis="the plant `delayed-states`, which every experiment of the chapter runs",
    ),
    statement(
        "Figures 5.3, 5.4: both controllers stabilise the plant", "yes",
        says("the certificate of (5.17)", "newest", "certified"),
        basis="growth of |X|^2 on the stacked state; (5.16) has a row of its own",
    ),
    statement(
        "5.5: a stochastic schedule needs a controller that is stochastically stable", "further research",
        below("growth of E|X|^2 per slot", "random_radius", 1),
        basis="turns independent and uniform, gains of the current packet of 3 samples, x(0) ~ N(0, I): "
        "mean cost {random_cost:.4f}",
    ),
)
# fmt: on
