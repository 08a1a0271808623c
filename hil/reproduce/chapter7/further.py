"""Chapter 7, what it leaves open: an estimate of d_k, gains for uncertain plants, gains that know how long d has lasted."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from design.errors import DesignError
from design.networked_loop.certify import certify_loop
from design.networked_loop.uncertainty import robust_h2, uncertainty_margin
from design.processes.delay_chain import DelayChain, Index
from design.requests.tracking import solve_tracking
from design.tracking.synthesis import Design, TrackingProblem, solve
from hil.compose.loop import compose
from hil.design_questions.design_problem import problem_for, tracking_target
from hil.design_questions.plant_uncertainty import PlantSet, interval, judge_uncertain, plants_between, robust_design
from hil.experiment import load_experiment
from hil.measure.prediction import predict
from hil.reproduce.chapter import ReportProgress
from hil.reproduce.chapter7.designs import best
from hil.reproduce.chapter7.emulated import stationary
from hil.reproduce.chapter7.models import NETWORK, Array, Plant, motor, vtol
from hil.reproduce.statements import ERRORS, Statement, above, below, exactly, says
from hil.rig.loop import Loop
from hil.sweeps.lockstep import run_batch
from plants.dc_motor import DCMotor

PLANTS = {"motor": motor, "vtol": vtol}
NAMES = {"motor": "motor", "vtol": "VTOL"}
PATTERNS = {"none": "tau", "estimate": "previous", "known": "generated"}
RUNS, SLOTS = 20_000, 300
R = 0.01

NARROW, WIDE = 10, 30
"""Uncertainty of the motor's gain, per cent to either side: what the nominal gains bear, and more than that."""

PERIOD_S = 0.05
EXPERIMENT, STAY_RUNS = "dc-motor-ours-stays", 200
STAY = np.array([
    [0.0, 1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.5, 0.5, 0.0],
    [0.0, 0.0, 0.0, 0.0, 1.0, 0.0], [0.5, 0.0, 0.0, 0.0, 0.0, 0.5], [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
])  # fmt: skip
DELAYS = np.array([0, 0, 0, 0, 1, 1])
"""A semi-Markov delay: 0 for three or four samples, then 1 for one or two, each as likely."""


def estimated_delay(report_progress: ReportProgress) -> dict[str, Any]:
    """H2 norms without an estimate of d_k, with it and with d_k itself; and the motor's, packet by packet.

    The controller knows d_k-1 (the sensor's packet carries it), so that its filter is one step of the chain:
    Pr{d_k = s} = pi_rs for r = d_k-1. In the place of a row for every d_k (7.13) it sends one command, by the mean gain
    sum_s pi_rs K(tau_k, s). With Pi invertible such gains are all gains over (tau_k, d_k-1), the information pattern
    ``previous``: K(tau, .) = Pi^-1 K_previous(tau, .).
    """
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


def uncertain(report_progress: ReportProgress) -> dict[str, Any]:
    """Margins, guaranteed costs and verdicts of both designs."""
    target = tracking_target("dc-motor")
    nominal = solve_tracking(problem_for(target))
    values: dict[str, Any] = {"nominal_h2": nominal.certificate.h2_norm}
    for n, (name, percent) in enumerate((("narrow", NARROW), ("wide", WIDE))):
        report_progress(f"gain +-{percent} %", n, 2)
        asked = [interval(target.of, f"gain={percent}%")]
        plants, ours = plants_between(target, asked), robust_design(target, nominal, asked)
        both = {"nominal": nominal, "ours": ours}
        margin = {who: _margin(design, plants) for who, design in both.items()}
        values[name] = {
            "margin": margin, "ratio": margin["ours"] / margin["nominal"],
            "cost": {who: _guaranteed(design, plants) for who, design in both.items()},
            "verdict": {who: judge_uncertain(target, design, asked).state for who, design in both.items()},
            "h2": ours.certificate.h2_norm,
        }  # fmt: skip
    return values


def _margin(design: Design, plants: PlantSet) -> float:
    return uncertainty_margin(design.problem.structure(), design.gains, plants.M, plants.N1, plants.N2)


def _guaranteed(design: Design, plants: PlantSet) -> float:
    try:
        return robust_h2(design.problem.structure(), design.gains, plants.M, plants.N1, plants.N2)[0]
    except DesignError:
        return math.inf


UNCERTAIN = (
    Statement(
        f"(7.41), Remark 7.6: gains for norm-bounded plants bear what the nominal ones do not, gain +-{WIDE} %", "can be solved",
        (
            says("verdict on our gains", "wide[verdict][ours]", "certified"),
            below("share of it that the small-gain theorem proves for the nominal gains", "wide[margin][nominal]", 1),
            above("the same for ours", "wide[margin][ours]", 1),
        ),
        computed="{wide[margin][ours]:.3f} of it against {wide[margin][nominal]:.3f}, {wide[ratio]:.2f} times; without "
        "uncertainty the H2 norm is {wide[h2]:.3f} against {nominal_h2:.3f}",
        basis="the motor over its network, H2, stacked z, rows by the d when they are applied; no design is printed. Verdict on "
        "the nominal gains: {wide[verdict][nominal]}",
    ),
    Statement(
        f"(7.41): the guaranteed cost of such gains is less than that of the nominal ones, gain +-{NARROW} %", "-",
        (
            below("guaranteed H2 norm over that of the nominal gains", "narrow[cost][ours]", "narrow[cost][nominal]"),
            above("certified uncertainty over that of the nominal gains", "narrow[ratio]", 1.05),
        ),
        computed="{narrow[cost][ours]:.4f} against {narrow[cost][nominal]:.4f}; they bear {narrow[ratio]:.2f} times as much",
        basis="both by the multiplier that proves least; without uncertainty {narrow[h2]:.3f} against {nominal_h2:.3f}",
    ),
)


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
    loops = [compose(load_experiment(EXPERIMENT, [f"controller.row_sojourns={count}"])) for count in (1, 4)]
    errors = [_squared_error(loop) for loop in loops]
    norms = [float(each.certificate.h2_norm or np.nan) for each in found]
    return {
        "plain": norms[0], "informed": norms[1], "again": again.h2_norm, "share": norms[1] / norms[0],
        "radius": found[1].certificate.mean_square_radius, "ran": (loops[1].certificate or {})["h2_norm"],
        "sse_plain": errors[0][0], "sse_informed": errors[1][0], "off": max(off for _, off in errors),
    }  # fmt: skip


def _squared_error(loop: Loop) -> tuple[float, float]:
    """Return the mean squared error of runs, rad^2 s, and how many standard errors it is from its prediction."""
    e = loop.experiment
    runs = run_batch(loop, range(STAY_RUNS))
    squares = (runs.outputs[0] - runs.reference[-1, 0])[:, runs.known] ** 2  # the error counts from t = 0, see Table 7.2
    sums = float(e.period) * squares.sum(axis=0)
    predicted = predict(loop, e.slots)
    expected = np.nan if predicted is None else predicted.sums[0].mean
    mean = float(sums.mean())
    return mean, abs(mean - expected) / (float(sums.std()) / np.sqrt(len(sums)))


STAYS = (
    Statement(
        "8.2.1: gains that know how long d has lasted, over a semi-Markov delay", "less conservative",
        (
            below("H2 norm with the stay of d over that without", "share", 1),
            below("second-moment radius with it", "radius", 1),
            exactly("H2 norm of the gains without it, by the loop that knows it", "again", "plain", 1e-9),
            exactly("H2 norm of the loop that runs", "ran", "informed", 1e-6),
        ),
        basis="DC motor at 0.05 s, no delay to the controller; d is 0 for three or four samples and 1 for one or two: "
        "{informed:.4f} against {plain:.4f}. `hil run dc-motor-ours-stays`: a packet has a row for every d and stay",
    ),
    Statement(
        "8.2.1: runs whose packets have a row for every d and how long it has lasted", "-",
        (below("distance of the runs from their prediction (standard errors)", "off", ERRORS),),
        computed="squared error {sse_informed:.4g} rad^2 s with the stay, {sse_plain:.4g} without",
        basis=f"{STAY_RUNS} runs of {EXPERIMENT}, packet by packet, and as many with row_sojourns = 1",
    ),
)
