"""Chapter 7, what it leaves open: gains for uncertain plants, gains that know how long d has lasted.

And the mixed design (7.33) as a curve, and lost packets as delays (Remark 7.1).
"""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np

from design.errors import DesignError
from design.jump_linear.second_moment import mean_square_radius
from design.networked_loop.certify import certify_loop
from design.networked_loop.closed_loop import loop_structure
from design.networked_loop.uncertainty import robust_h2, uncertainty_margin
from design.processes.delay_chain import DelayChain
from design.requests.tracking import solve_tracking
from design.tracking.synthesis import Design, TrackingProblem, solve
from hil.compose.loop import compose
from hil.design_questions.design_problem import problem_for, tracking_target
from hil.design_questions.plant_uncertainty import PlantSet, interval, judge_uncertain, plants_between, robust_design
from hil.experiment import load_experiment
from hil.pages.html.figures import Figure, Series
from hil.thesis.chapter import Plot, ReportProgress
from hil.thesis.chapter7.designs import best
from hil.thesis.chapter7.emulated import BATCH_RUNS, on_all_cores, squared_error
from hil.thesis.chapter7.friction import errors_of
from hil.thesis.chapter7.models import H2, motor
from hil.thesis.statements import ERRORS, Statement, above, below, exactly, says
from plants.dc_motor import DCMotor

NARROW, WIDE = 10, 30
"""Uncertainty of the motor's gain, per cent to either side: what the nominal gains bear, and more than that."""

PERIOD_S = 0.05
EXPERIMENT = "dc-motor-ours-stays"
REALISTIC = {"static": "dc-motor-h2-friction", "dynamic": "dc-motor-ours-integral"}
STAY = np.array([
    [0.0, 1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.5, 0.5, 0.0],
    [0.0, 0.0, 0.0, 0.0, 1.0, 0.0], [0.5, 0.0, 0.0, 0.0, 0.0, 0.5], [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
])  # fmt: skip
DELAYS = np.array([0, 0, 0, 0, 1, 1])
"""A semi-Markov delay: 0 for three or four samples, then 1 for one or two, each as likely."""


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
        return math.nan


UNCERTAIN = (
    Statement(
        f"(7.41), Remark 7.6: gains for norm-bounded plants are proved for what the nominal ones are not, gain +-{WIDE} %",
        "can be solved",
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


def integral_action(report_progress: ReportProgress) -> dict[str, Any]:
    """Steady-state errors of the realistic motor with the published H2 gains, and with integral action."""
    steady, sse = {}, {}
    for n, (who, name) in enumerate(REALISTIC.items()):
        report_progress(name, n, len(REALISTIC))
        found = errors_of(compose(load_experiment(name), certify=False), range(BATCH_RUNS))
        steady[who], sse[who] = np.abs(found[:, 2]), float(found[:, 0].mean())
    less, verdict = steady["static"] - steady["dynamic"], compose(load_experiment(REALISTIC["dynamic"])).verdict
    return {
        "mean": {who: float(each.mean()) for who, each in steady.items()}, "sse": sse,
        "surely": float(less.mean()) - ERRORS * float(less.std()) / math.sqrt(BATCH_RUNS),
        "half": 0.5 * float(steady["static"].mean()), "verdict": "none" if verdict is None else verdict.state,
    }  # fmt: skip


INTEGRAL = (
    Statement(
        "Remark 7.7: a dynamic controller enhances the steady-state tracking", "to further enhance",
        (
            above("fall of the mean |error| less 4 standard errors, rad,", "surely", 0),
            below("mean |error| with integral action, rad,", "mean[dynamic]", "half"),
            says("verdict on its loop", "verdict", "certified"),
        ),
        computed="{mean[dynamic]:.4f} rad with integral action, {mean[static]:.4f} rad without; squared error from the step on "
        "{sse[dynamic]:.4g} and {sse[static]:.4g} rad^2 s",
        basis=f"{REALISTIC['dynamic']} and {REALISTIC['static']}, {BATCH_RUNS} runs each, mean over 20 to 30 s; enhanced: to "
        "less than half. Feedback plus feedforward is (7.11) itself, by Omega_22",
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
    errors = [squared_error(loop) for loop in loops]
    norms = [float(each.certificate.h2_norm or np.nan) for each in found]
    return {
        "plain": norms[0], "informed": norms[1], "again": again.h2_norm, "share": norms[1] / norms[0],
        "radius": found[1].certificate.mean_square_radius, "ran": (loops[1].certificate or {})["h2_norm"],
        "sse_plain": errors[0][0], "sse_informed": errors[1][0], "off": float(np.max([off for _, off in errors])),
    }  # fmt: skip


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
        basis=f"{BATCH_RUNS} runs of {EXPERIMENT}, packet by packet, and as many with row_sojourns = 1",
    ),
)


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
        "gained": 1.0 - float(gamma[0] / gamma[-1]), "chain": _over_chains(), "packets": _packet_by_packet(),
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


def _packet_by_packet() -> float:
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
    Statement(
        "(7.33): a compromise between H2 and H-infinity by a prescribed gamma", "min beta s.t. (7.24) and (7.30)",
        (
            below("largest H-infinity norm over its level, less 1", "over", 1e-6),
            below("largest rise of beta as the level is let go", "rise", SLACK),
            above("what the tightest level costs in beta", "paid", SLACK),
            above("what it gains in gamma", "gained", SLACK),
        ),
        computed="gamma {ends[0]:.5g} ... {ends[1]:.5g}, beta {ends[2]:.5g} ... {ends[3]:.5g}",
        basis="the motor over its network, stacked z, R = 0.01, rows by the d when they are applied; no mixed design is printed",
    ),
    Statement(
        "Remark 7.1: packets lost, at most so many in a row, are delays of (7.3)-(7.5)", "can accommodate packet dropouts",
        (exactly("second-moment radius over the chain of ages", "chain", "packets", 1e-9),),
        computed="{chain:.10g} over the chain of ages, {packets:.10g} packet by packet",
        basis=f"the motor with (7.37); to the controller a packet is lost with chance {LOST[0]:g}, {MOST_LOST[0]} in a row "
        f"at most, to the actuator {LOST[1]:g} and {MOST_LOST[1]}; beside it nothing but what the receivers hold",
    ),
)
# fmt: on
