"""What Chapter 7 leaves open about delays: an estimate of d_k, how long d has lasted, lost packets; and the mixed design (7.33).

The estimate is the state of the chain, in the place of a row for every d_k (Section 7.2, after (7.13)); lost packets are delays
(Remark 7.1).
"""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from design.jump_linear import h2_derivative
from design.jump_linear.second_moment import mean_square_radius
from design.networked_loop.certify import certify_loop
from design.networked_loop.closed_loop import loop_structure
from design.processes.delay_chain import DelayChain, Index
from design.tracking.bfgs import bfgs
from design.tracking.synthesis import TrackingProblem, solve
from hil.compose import compose
from hil.experiment import load_experiment
from hil.pages import Figure, Series
from hil.thesis import Array, Plot, ReportProgress
from hil.thesis.chapter7_designs import NAME, PLANTS, TIE, best
from hil.thesis.chapter7_models import H2, NETWORK, Plant, motor
from hil.thesis.chapter7_runs import BATCH_RUNS, on_all_cores, squared_error
from hil.thesis.statements import ERRORS, above, below, exactly, statement
from plants.dc_motor import DCMotor

PATTERNS = {"none": "tau", "estimate": "previous", "known": "generated"}
RUNS, SLOTS = 20_000, 300
R = 0.01
H2_EXPERIMENT = "dc-motor-ours-h2"


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
    stationary = np.linalg.matrix_power(pi, 1024)[0]
    loop = compose(load_experiment(H2_EXPERIMENT, ['controller.information="previous"']))
    mean, apart = squared_error(loop)
    return found | late_estimate(estimated) | {
        "ran": (loop.certificate or {})["h2_norm"], "sse": mean, "apart": apart,
        "runs": math.sqrt(square), "error": error / (2.0 * math.sqrt(square)),
        "off": abs(square - found["motor"]["estimate"] ** 2) / error, "right": float(stationary @ pi.max(axis=1)),
        "guess": float(stationary.max()),
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
        tau, d = (following(rng, limit, mode) for limit, mode in zip(sums, (tau, d), strict=True))
        outputs = [x @ plant.C.T, *outputs[:2]]
        total += (outputs[0] ** 2).sum(axis=1) + ((R * commands[0]) ** 2).sum(axis=1)
        gain = np.einsum("ns,nsmp->nmp", filtered, gains[tau])
        commands = [np.einsum("nmp,np->nm", gain, np.stack(outputs)[tau, every]), commands[0]]
        x = x @ plant.A.T + np.stack(commands)[d, every] @ plant.B.T
    return float(total.mean()), float(total.std() / math.sqrt(runs))


def following(rng: np.random.Generator, sums: Array, mode: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """Draw the mode after each; ``sums`` has the summed rows of the matrix, but for their last entry."""
    return np.asarray((rng.random(len(mode))[:, None] > sums[mode]).sum(axis=1))


def late_estimate(previous: Array) -> dict[str, Any]:
    """H2 norms of the motor where d comes with the sample: the controller knows d of slot k - 1 - tau_k, or no d at all.

    Modes of the chain are (d_k, d_k-1, d_k-2), so that the gain of tau reads the label of the slot before at place tau.

    Args:
        previous: gains over (tau_k, d_k-1), [tau, r, m, p], at which the descent starts.
    """
    pasts = list(product(range(len(NETWORK[1])), repeat=len(NETWORK[0])))
    moves = np.array([[NETWORK[1][old[0], new[0]] * (new[1:] == old[:-1]) for new in pasts] for old in pasts])
    chain = DelayChain(transition=moves, delays=np.array([past[0] for past in pasts]), labels=np.arange(len(pasts)))
    loop = loop_structure(*motor(), NETWORK[0], chain, "previous")

    def least(start: Array, rows: npt.NDArray[np.intp]) -> float:
        """By a descent from gains whose rows are those that each tau and past reads."""
        at = np.arange(len(start))[:, None], rows

        def norm(v: Array) -> tuple[float, Array]:
            gains = v.reshape(start.shape)
            found = h2_derivative(loop.matrices(gains[at]), loop.B, loop.C, loop.transition, loop.default_initial)
            if found is None:
                return math.inf, v
            slope, size = np.zeros_like(gains), math.sqrt(found.square)
            np.add.at(slope, at, loop.gain_gradient(found.gradient_A))
            return size, slope.ravel() / (2.0 * size)

        return bfgs(norm, start.ravel()).value

    seen = np.array(pasts).T
    late, none = least(previous, seen), least(previous[:, :1], 0 * seen)
    return {"late": late, "without": none, "late_less": 1.0 - late / none}


ESTIMATED = (
    *(
        statement(
            f"{NAME[name]}: d_k estimated by the state of its chain at the controller, one command a packet, H2",
            "Section 7.2, another potential method",
            above("what it gains over gains that know tau alone", f"{name}[less]", TIE),
            computed=f"{{{name}[estimate]:.5g}} against {{{name}[none]:.5g}} without; a row for every d_k {{{name}[known]:.5g}}",
            basis="d_k-1 is known, gains are means over the filter; stacked z, R = 0.01. The likeliest d_k is right in "
            "{right:.1%} of the slots, {guess:.1%} without d_k-1",
        )
        for name in PLANTS
    ),
    statement(
        "motor: the same where the controller knows the d that came with its sample, of slot k - 1 - tau_k",
        "Section 7.2, another potential method",
        above("what it gains over gains that know tau alone", "late_less", TIE),
        computed="{late:.6g} against {without:.6g}: {late_less:.3%}, where d_k-1 itself gains {motor[less]:.3%}",
        basis="H2, initial modes uniform over (d_k, d_k-1, d_k-2); only the sensor's packet can bring the controller a d",
    ),
    statement(
        "motor: a controller that filters d_k and sends one command costs what its certificate says", "-",
        below("distance of the runs from the certificate (standard errors)", "off", ERRORS),
        exactly("H2 norm of the loop on the rig, information = previous", "ran", "motor[estimate]", 1e-6),
        below("distance of its squared error from the prediction (standard errors)", "apart", ERRORS),
        computed="{runs:.4f} +- {error:.4f} in runs, {motor[estimate]:.4f} by the certificate; squared error on the rig "
        "{sse:.4g} rad^2 s",
        basis=f"{RUNS} runs of {SLOTS} slots, packet by packet, from an impulse at the input; on the rig {H2_EXPERIMENT} with "
        f"information = previous, {BATCH_RUNS} runs: the row of d_k-1 is the mean over the filter",
    ),
)  # fmt: skip

PERIOD_S = 0.05
STAYS_EXPERIMENT = "dc-motor-ours-stays"
STAY = np.array([
    [0.0, 1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.5, 0.5, 0.0],
    [0.0, 0.0, 0.0, 0.0, 1.0, 0.0], [0.5, 0.0, 0.0, 0.0, 0.0, 0.5], [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
])  # fmt: skip
DELAYS = np.array([0, 0, 0, 0, 1, 1])
"""A semi-Markov delay: 0 for three or four samples, then 1 for one or two, each as likely."""


def stays(report_progress: ReportProgress) -> dict[str, Any]:
    """Return the H2 norms of our designs for the motor whose rows know d alone, and d and its stay; and squared errors of runs.

    Args:
        report_progress: takes the share that is done.
    """
    model = DCMotor().model().discretise(PERIOD_S)
    sc = DelayChain(transition=np.ones((1, 1)))
    plain, informed = (DelayChain(transition=STAY, delays=DELAYS, labels=labels) for labels in (DELAYS, np.arange(6)))
    found = [
        solve(TrackingProblem(A=model.A, B=model.B, C=model.C, sc=sc, ca=ca, objective="h2", information="applied"))
        for ca in (plain, informed)
    ]
    repeated = np.asarray(found[0].gains)[:, DELAYS]
    again = certify_loop(model.A, model.B, model.C, sc, informed, repeated, "applied")
    loops = [compose(load_experiment(STAYS_EXPERIMENT, [f"controller.row_sojourns={count}"])) for count in (1, 4)]
    errors = [squared_error(loop) for loop in loops]
    norms = [float(each.certificate.h2_norm or np.nan) for each in found]
    return {
        "plain": norms[0], "informed": norms[1], "again": again.h2_norm, "share": norms[1] / norms[0],
        "radius": found[1].certificate.mean_square_radius, "ran": (loops[1].certificate or {})["h2_norm"],
        "sse_plain": errors[0][0], "sse_informed": errors[1][0], "off": float(np.max([off for _, off in errors])),
    }  # fmt: skip


STAYS = (
    statement(
        "8.2.1: gains that know how long d has lasted, over a semi-Markov delay", "less conservative",
        below("H2 norm with the stay of d over that without", "share", 1),
        below("second-moment radius with it", "radius", 1),
        exactly("H2 norm of the gains without it, by the loop that knows it", "again", "plain", 1e-9),
        exactly("H2 norm of the loop that runs", "ran", "informed", 1e-6),
        basis="DC motor at 0.05 s, no delay to the controller; d is 0 for three or four samples and 1 for one or two: "
        "{informed:.4f} against {plain:.4f}. `hil run dc-motor-ours-stays`: a packet has a row for every d and stay",
    ),
    statement(
        "8.2.1: runs whose packets have a row for every d and how long it has lasted", "-",
        below("distance of the runs from their prediction (standard errors)", "off", ERRORS),
        computed="squared error {sse_informed:.4g} rad^2 s with the stay, {sse_plain:.4g} without",
        basis=f"{BATCH_RUNS} runs of {STAYS_EXPERIMENT}, packet by packet, and as many with row_sojourns = 1",
    ),
)  # fmt: skip

LEVELS = (1.003, 1.01, 1.02, 1.04, 1.06)
"""H-infinity levels of the mixed designs, over the smallest that is reached."""
LOST, MOST_LOST = (0.3, 0.4), (2, 1)
"""Probability that a packet is lost, and how many are in a row at most, to the controller and to the actuator."""
SLACK = 1e-3
"""Share by which a descent may end above the minimum."""


def trade_off(report_progress: ReportProgress) -> dict[str, Any]:
    """Smallest H2 norm of the motor's loop for every H-infinity level, and the loop over packets that are lost."""
    ends = on_all_cores(_norms, [("hinf", None), ("h2", None)], report_progress, ["H-infinity", "H2"])
    least = ends[0][1]
    asked = [("mixed", share * least) for share in LEVELS]
    mixed = on_all_cores(_norms, asked, report_progress, [f"gamma {level:.4g}" for _, level in asked])
    beta, gamma = (np.array([each[i] for each in (*mixed, ends[1])]) for i in (0, 1))
    curve = Series(label="designs by (7.33)", x=gamma, y=beta)
    figure = Figure(
        title="H2 norm against H-infinity norm of the motor's loop", series=(curve,), x_label="H-infinity norm", x_unit="",
        y_label="H2 norm", sync=None, note="the last design has no level; stacked z, rows by the d when they are applied",
    )  # fmt: skip
    return {
        "beta": beta, "gamma": gamma, "ends": [gamma[0], gamma[-1], beta[0], beta[-1]],
        "over": float((gamma[:-1] / [level for _, level in asked]).max()) - 1.0,
        "rise": float((beta[1:] / beta[:-1]).max()) - 1.0, "paid": float(beta[0] / beta[-1]) - 1.0,
        "gained": 1.0 - float(gamma[0] / gamma[-1]), "chain": _over_chains(), "packets": _radius_by_packets(),
        "figures": (Plot(title="Trade-off of the two norms", panels=(figure,)),),
    }  # fmt: skip


def _norms(objective: str, level: float | None) -> tuple[float, float]:
    certificate = best(motor(), objective=objective, information="applied", hinf_bound=level).certificate
    h2, hinf = (np.nan if norm is None else float(norm) for norm in (certificate.h2_norm, certificate.hinf_norm))
    return h2, hinf


def _over_chains() -> float:
    """Radius of the second moments with the age of the newest packet that came as the delay."""
    chains = []
    for lost, most in zip(LOST, MOST_LOST):
        chain = np.zeros((most + 1, most + 1))
        chain[:, 0] = 1.0 - lost
        chain[most, 0] = 1.0
        chain[np.arange(most), np.arange(1, most + 1)] = lost
        chains.append(chain)
    plant = motor()
    structure = loop_structure(plant.A, plant.B, plant.C, chains[0], chains[1], "applied")
    return mean_square_radius(structure.matrices(H2), structure.transition)


def _radius_by_packets() -> float:
    """The same radius with no delay in it: what each receiver holds, and how many packets in a row it has missed."""
    A, B, C = motor()
    n, size = len(A), len(A) + 3  # x, the sample that the controller holds, the two rows that the actuator holds
    modes = list(product(range(MOST_LOST[0] + 1), range(MOST_LOST[1] + 1)))
    operator = np.zeros((len(modes), size**2, len(modes), size**2))
    for at, missed in enumerate(modes):
        for came in product((True, False), repeat=2):
            chance, now = 1.0, []
            for lost, most, before, through in zip(LOST, MOST_LOST, missed, came):
                chance *= (1.0 if through else 0.0) if before == most else (1.0 - lost if through else lost)
                now.append(0 if through else before + 1)
            if not chance:
                continue
            held = np.hstack([C, np.zeros((1, 3))]) if came[0] else np.eye(1, size, n)
            rows = np.vstack([H2[now[0], d, 0] @ held for d in range(2)]) if came[1] else np.eye(2, size, n + 1)
            F = np.vstack([np.hstack([A, np.zeros((n, 3))]) + B @ rows[now[1]][None], held, rows])
            operator[modes.index((now[0], now[1])), :, at] += chance * np.kron(F, F)
    return float(np.abs(np.linalg.eigvals(operator.reshape(len(modes) * size**2, -1))).max())


# fmt: off
TRADE_OFF = (
    statement(
        "(7.33): a compromise between H2 and H-infinity by a prescribed gamma", "min beta s.t. (7.24) and (7.30)",
        below("largest H-infinity norm over its level, less 1", "over", 1e-6),
        below("largest rise of beta as the level is let go", "rise", SLACK),
        above("what the tightest level costs in beta", "paid", SLACK),
        above("what it gains in gamma", "gained", SLACK),
        computed="gamma {ends[0]:.5g} ... {ends[1]:.5g}, beta {ends[2]:.5g} ... {ends[3]:.5g}",
        basis="the motor over its network, stacked z, R = 0.01, rows by the d when they are applied; no mixed design is printed",
    ),
    statement(
        "Remark 7.1: packets lost, at most so many in a row, are delays of (7.3)-(7.5)", "can accommodate packet dropouts",
        exactly("second-moment radius over the chain of ages", "chain", "packets", 1e-9),
        computed="{chain:.10g} over the chain of ages, {packets:.10g} packet by packet",
        basis=f"the motor with (7.37); to the controller a packet is lost with chance {LOST[0]:g}, {MOST_LOST[0]} in a row "
        f"at most, to the actuator {LOST[1]:g} and {MOST_LOST[1]}; beside it nothing but what the receivers hold",
    ),
)
# fmt: on
