"""An estimate of d_k by the state of its chain, in the place of a row for every d_k (Section 7.2, after (7.13))."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from design.networked_loop.certify import certify_loop
from design.processes.delay_chain import DelayChain, Index
from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.thesis.chapter import ReportProgress
from hil.thesis.chapter7.designs import NAME, PLANTS, TIE, best
from hil.thesis.chapter7.emulated import BATCH_RUNS, squared_error, stationary
from hil.thesis.chapter7.models import NETWORK, Array, Plant, motor
from hil.thesis.statements import ERRORS, Statement, above, below, exactly

PATTERNS = {"none": "tau", "estimate": "previous", "known": "generated"}
RUNS, SLOTS = 20_000, 300
R = 0.01
UNSTABLE = 1e3
"""In the place of a norm that does not exist, for a descent by differences."""

EXPERIMENT = "dc-motor-ours-h2"


def estimated_delay(report_progress: ReportProgress) -> dict[str, Any]:
    """H2 norms without an estimate of d_k, with it and with d_k itself; and the motor's, packet by packet.

    The controller knows d_k-1 (the sensor's packet carries it), so that its filter is one step of the chain:
    Pr{d_k = s} = pi_rs for r = d_k-1. In the place of a row for every d_k (7.13) it sends one command, by the mean gain
    sum_s pi_rs K(tau_k, s). With Pi invertible such gains are all gains over (tau_k, d_k-1), the information pattern
    ``previous``: K(tau, .) = Pi^-1 K_previous(tau, .).
    """
    found: dict[str, Any] = {}
    for n, (name, plant) in enumerate(PLANTS.items()):
        report_progress(NAME[name], n, len(PLANTS) + 1)
        designs = {what: best(plant(), objective="h2", information=pattern) for what, pattern in PATTERNS.items()}
        norms = {what: float(design.certificate.h2_norm or math.nan) for what, design in designs.items()}
        if name == "motor":
            estimated = designs["estimate"].gains
            gains = by_estimate(estimated)
            problem = designs["estimate"].problem
            structure = problem.structure()
            modes = structure.sc_mode, structure.ca_mode, problem.alpha(structure)
        found[name] = norms | {"less": 1.0 - norms["estimate"] / norms["none"]}
    report_progress("the motor, packet by packet", len(PLANTS), len(PLANTS) + 1)
    square, error = packet_by_packet(motor(), gains, *modes)
    pi = NETWORK[1]
    loop = compose(load_experiment(EXPERIMENT, ['controller.information="previous"']))
    mean, apart = squared_error(loop)
    return found | late_estimate(estimated) | {
        "ran": (loop.certificate or {})["h2_norm"], "sse": mean, "apart": apart,
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


def late_estimate(previous: Array) -> dict[str, Any]:
    """H2 norms of the motor where d comes with the sample: the controller knows d of slot k - 1 - tau_k, or no d at all.

    Modes of the chain are (d_k, d_k-1, d_k-2), so that the gain of tau reads the label of the slot before at place tau.

    Args:
        previous: gains over (tau_k, d_k-1), [tau, r, m, p], at which the descent starts.
    """
    from scipy.optimize import minimize

    pasts = list(itertools.product(range(len(NETWORK[1])), repeat=len(NETWORK[0])))
    moves = np.array([[NETWORK[1][old[0], new[0]] * (new[1:] == old[:-1]) for new in pasts] for old in pasts])
    chain = DelayChain(transition=moves, delays=np.array([past[0] for past in pasts]), labels=np.arange(len(pasts)))

    def norm(gains: Array) -> float:
        table = np.array([[K[past[tau]] for past in pasts] for tau, K in enumerate(gains)])
        return certify_loop(*motor(), NETWORK[0], chain, table, "previous").h2_norm or UNSTABLE

    def by_both(v: Array) -> float:
        return norm(v.reshape(previous.shape))

    def by_tau(v: Array) -> float:
        return norm(v.reshape(previous[:, :1].shape).repeat(previous.shape[1], axis=1))

    found = minimize(by_both, previous.ravel(), method="BFGS")
    alone = minimize(by_tau, previous[:, 0].ravel(), method="BFGS")
    late, none = float(found.fun), float(alone.fun)
    return {"late": late, "without": none, "late_less": 1.0 - late / none}


ESTIMATED = (
    *(
        Statement(
            f"{NAME[name]}: d_k estimated by the state of its chain at the controller, one command a packet, H2",
            "Section 7.2, another potential method",
            (above("what it gains over gains that know tau alone", f"{name}[less]", TIE),),
            computed=f"{{{name}[estimate]:.5g}} against {{{name}[none]:.5g}} without; a row for every d_k {{{name}[known]:.5g}}",
            basis="d_k-1 is known, gains are means over the filter; stacked z, R = 0.01. The likeliest d_k is right in "
            "{right:.1%} of the slots, {guess:.1%} without d_k-1",
        )
        for name in PLANTS
    ),
    Statement(
        "motor: the same where the controller knows the d that came with its sample, of slot k - 1 - tau_k",
        "Section 7.2, another potential method",
        (above("what it gains over gains that know tau alone", "late_less", TIE),),
        computed="{late:.6g} against {without:.6g}: {late_less:.3%}, where d_k-1 itself gains {motor[less]:.3%}",
        basis="H2, initial modes uniform over (d_k, d_k-1, d_k-2); only the sensor's packet can bring the controller a d",
    ),
    Statement(
        "motor: a controller that filters d_k and sends one command costs what its certificate says", "-",
        (
            below("distance of the runs from the certificate (standard errors)", "off", ERRORS),
            exactly("H2 norm of the loop on the rig, information = previous", "ran", "motor[estimate]", 1e-6),
            below("distance of its squared error from the prediction (standard errors)", "apart", ERRORS),
        ),
        computed="{runs:.4f} +- {error:.4f} in runs, {motor[estimate]:.4f} by the certificate; squared error on the rig "
        "{sse:.4g} rad^2 s",
        basis=f"{RUNS} runs of {SLOTS} slots, packet by packet, from an impulse at the input; on the rig {EXPERIMENT} with "
        f"information = previous, {BATCH_RUNS} runs: the row of d_k-1 is the mean over the filter",
    ),
)
