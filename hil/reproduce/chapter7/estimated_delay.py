"""After (7.13): the controller estimates d_k by the state of its chain, in the place of sending a row for every d_k.

The controller knows d_k-1 (the sensor's packet carries it), so that its filter is one step of the chain: Pr{d_k = s} = pi_rs for
r = d_k-1. It sends one command, by the mean gain sum_s pi_rs K(tau_k, s). With Pi invertible such gains are all gains over
(tau_k, d_k-1), the information pattern ``previous``: K(tau, .) = Pi^-1 K_previous(tau, .).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from design.processes.delay_chain import Index
from hil.reproduce.chapter import ReportProgress
from hil.reproduce.chapter7.designs import best
from hil.reproduce.chapter7.emulated import stationary
from hil.reproduce.chapter7.models import NETWORK, Array, Plant, motor, vtol
from hil.reproduce.statements import ERRORS, Statement, above, below

PLANTS = {"motor": motor, "vtol": vtol}
NAMES = {"motor": "motor", "vtol": "VTOL"}
PATTERNS = {"none": "tau", "estimate": "previous", "known": "generated"}
RUNS, SLOTS = 20_000, 300
R = 0.01


def estimated_delay(report_progress: ReportProgress) -> dict[str, Any]:
    """H2 norms without the estimate, with it and with d_k itself; and the motor's, packet by packet."""
    found: dict[str, Any] = {}
    for n, (name, plant) in enumerate(PLANTS.items()):
        report_progress(NAMES[name], n, len(PLANTS) + 1)
        designs = {what: best(plant(), objective="h2", information=pattern) for what, pattern in PATTERNS.items()}
        norms = {what: float(design.certificate.h2_norm or math.nan) for what, design in designs.items()}
        if name == "motor":
            gains = by_estimate(designs["estimate"].gains)
            problem = designs["estimate"].problem
            structure = problem.structure()
            modes = structure.sc_mode, structure.ca_mode, problem.alpha(structure)
        found[name] = norms | {"less": 1.0 - norms["estimate"] / norms["none"]}
    report_progress("the motor, packet by packet", len(PLANTS), len(PLANTS) + 1)
    square, error = packet_by_packet(motor(), gains, *modes)
    pi = NETWORK[1]
    return found | {
        "runs": math.sqrt(square), "error": error / (2.0 * math.sqrt(square)),
        "off": abs(square - found["motor"]["estimate"] ** 2) / error, "right": float(stationary(pi) @ pi.max(axis=1)),
        "guess": float(stationary(pi).max()),
    }  # fmt: skip


def by_estimate(previous: Array) -> Array:
    """Return K[tau, s, m, p] whose mean under the filter is the gain of ``previous``, [tau, r, m, p]."""
    return np.asarray(np.einsum("sr,trmp->tsmp", np.linalg.inv(NETWORK[1]), previous))


def packet_by_packet(
    plant: Plant, gains: Array, sc_mode: Index, ca_mode: Index, alpha: Array, runs: int = RUNS, seed: int = 0
) -> tuple[float, float]:
    """Return sum_k E |z(k)|^2 after an impulse at the input, and its standard error; one input, one command a packet.

    Args:
        plant: A, B, C.
        gains: K[tau, s, m, p], averaged by the filter at the controller.
        sc_mode, ca_mode, alpha: tau, d and probability of the modes at the impulse.
        runs: how many.
        seed: of the modes.
    """
    rng, every = np.random.default_rng(seed), np.arange(runs)
    first = rng.choice(len(alpha), p=alpha, size=runs)
    tau, d = np.asarray(sc_mode)[first], np.asarray(ca_mode)[first]
    sums = [np.cumsum(matrix, axis=1)[:, :-1] for matrix in NETWORK]
    x, total = np.tile(plant.B[:, 0], (runs, 1)), np.zeros(runs)
    outputs, commands = [np.zeros((runs, len(plant.C)))] * 3, [np.zeros((runs, 1))] * 2
    for _ in range(SLOTS):
        filtered = NETWORK[1][d]  # of the d that the sensor saw last: Pr{d_k = s}
        tau, d = (np.sum(rng.random(runs)[:, None] > limit[mode], axis=1) for limit, mode in zip(sums, (tau, d), strict=True))
        outputs = [x @ plant.C.T, *outputs[:2]]
        total += (outputs[0] ** 2).sum(axis=1) + ((R * commands[0]) ** 2).sum(axis=1)
        gain = np.einsum("ns,nsmp->nmp", filtered, gains[tau])
        commands = [np.einsum("nmp,np->nm", gain, np.stack(outputs)[tau, every]), commands[0]]
        x = x @ plant.A.T + np.stack(commands)[d, every] @ plant.B.T
    return float(total.mean()), float(total.std() / math.sqrt(runs))


ESTIMATED = (
    *(
        Statement(
            f"{NAMES[name]}: d_k estimated by the state of its chain at the controller, one command a packet, H2",
            "Section 7.2, another potential method",
            (
                below("smallest H2 norm with the estimate", f"{name}[estimate]", f"{name}[none]"),
                above("what it gains over gains that know tau alone", f"{name}[less]", 1e-4),
            ),
            computed=f"{{{name}[estimate]:.5g}} against {{{name}[none]:.5g}} without; a row for every d_k {{{name}[known]:.5g}}",
            basis="d_k-1 is known, gains are means over the filter; stacked z, R = 0.01. The likeliest d_k is right in "
            "{right:.1%} of the slots, {guess:.1%} without d_k-1",
        )
        for name in PLANTS
    ),
    Statement(
        "motor: a controller that filters d_k and sends one command costs what its certificate says", "-",
        (below("distance of the runs from the certificate (standard errors)", "off", ERRORS),),
        computed="{runs:.4f} +- {error:.4f} in runs, {motor[estimate]:.4f} by the certificate",
        basis=f"{RUNS} runs of {SLOTS} slots, packet by packet, from an impulse at the input",
    ),
)
