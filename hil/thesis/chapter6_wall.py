"""The mixed wall of Chapter 6: its transition matrix, whether sliding has no memory, and a coupler for each material.

And the weight of (6.12), the search of (6.15), and what 6.6 leaves for later work.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import groupby, islice
from typing import Any

import numpy as np
from scipy.special import chdtri

from design.as_printed.chapters_5_and_6 import DELAY, LAMBDA, PERIOD_S, meets_printed_condition, printed_distortion
from design.controllers.rendered_wall import Coupler, WallController, static_coupler, wave_coupler
from design.controllers.wall import MATERIALS, Contact, Wall
from design.controllers.wall_pattern import boundaries, material_chain, memory_statistic, paced_chain, square_rows, true_chain
from design.jump_linear.bounded_real import hinf_norm
from design.passivity.certificate import lags
from design.passivity.synthesis import Weight, ceiling_n_per_m, stiffest_coupler
from design.passivity.transparency import distortion, felt_n_per_m, sparing
from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.thesis.chapter6_equations import SIDE_M, STEP_M, WAVE, B, distortion_norm, loop_of, safe_coupler
from hil.thesis.statements import above, below, exactly, says, statement

MODES_610 = (1, 2, 1, 2, 1, 0)  # {2, 3, 2, 3, 2, 1}
LEVEL = 1e-3


def wall() -> dict[str, Any]:
    """Return the numbers of Section 6.2.2 and of Figure 6.10."""
    pattern, printed = square_rows(SIDE_M), np.array(LAMBDA)
    lengths, areas = boundaries(pattern, 3)
    leaving = 1.0 - np.diag(printed)
    statistic, freedom = memory_statistic(list(slide(0.35, 20_000)), 3)
    limit = float(chdtri(freedom, LEVEL))
    heading = next((a for a in np.linspace(0.05, 1.5, 300).tolist() if visits(a) == MODES_610), math.nan)
    stationary = areas / areas.sum()
    return {
        "error": float(np.abs(material_chain(pattern, 3, STEP_M) - printed).max()), "entry": float(printed.max()),
        "apart": float(leaving.max() / leaving.min()), "balance": float(np.abs(stationary @ printed - stationary).max()),
        "areas": float(areas[2] / areas[0]), "length": lengths[0, 1], "freedom": freedom, "G": statistic, "limit": limit,
        "far": 10.0 * limit, "heading": math.degrees(heading),
        "slide": "not found" if math.isnan(heading) else "found",
        "off": float(np.abs(true_chain(pattern, 3, STEP_M) - printed).max()),
    }  # fmt: skip


def slide(heading: float, samples: int, step_m: float = STEP_M) -> Iterator[int]:
    """Yield the materials that a straight slide meets, one per sample."""
    find = square_rows(SIDE_M).finder()
    y, z = math.cos(heading) * step_m, math.sin(heading) * step_m
    return (find(1.5 * SIDE_M + k * y, 0.1 * SIDE_M + k * z) for k in range(samples))


def visits(heading: float) -> tuple[int, ...]:
    """Return the first six different materials of a straight slide, in fine steps."""
    return tuple(material for material, _ in islice(groupby(slide(heading, 2000, 0.02 * SIDE_M)), 6))


# fmt: off
WALL = (
    statement(
        "6.5: Lambda from a pattern of patches", "0.4 0.3 0.3; 0.3 0.4 0.3; 0.15 0.15 0.7",
        exactly("largest difference", "error", 0, 1e-12, "entry"),
        basis="lambda_ij = nu T c_ij/(pi A_i) over rows of squares between strips, nu T = 0.15 pi w",
    ),
    statement(
        "(6.3): lambda_ij in proportion to c_ij/sum c_ij and nu", "one factor for every i",
        exactly("ratio of the probabilities with which Lambda leaves its materials", "apart", 1, 1e-9),
        witness=(above("that ratio", "apart", 1.0 + 1e-9),),
        basis="the printed rows of (6.3) sum to nu times one factor; the areas are missing from it",
    ),
    statement(
        "6.5.2: material 3 is left less often, as its area is larger", "0.15 < 0.3",
        exactly("distance of the area shares from the stationary law of Lambda", "balance", 0, 1e-12),
        above("area of material 3 over that of material 1", "areas", 1),
        basis="the same pattern; boundaries of {length:g} m each",
    ),
    statement(
        "6.2.2: one step of the avatar follows Lambda", "Lambda",
        below("distance of the exact one-step matrix of the geometry", "off", 0.02),
        basis="uniform place and direction, nu T = 0.15 pi w; the linear law holds for short steps only",
    ),
    statement(
        "6.1: the movement is independent of the past, so the material is a Markov process", "memoryless",
        below(f"G on {{freedom}} degrees of freedom, level {LEVEL:g}:", "G", "limit"), witness=(above("G", "G", "far"),),
        basis="20,000 samples of a straight slide at the published speed",
    ),
    statement(
        "Figure 6.10: the modes {2, 3, 2, 3, 2, 1}", "2 3 2 3 2 1",
        says("a straight slide that shows them", "slide", "found"),
        computed="heading {heading:.2f} degrees", basis="the same pattern, from within material 2, of 300 headings",
    ),
)
# fmt: on

CUTOFF_HZ = 3.0
DEPTH_M = 0.1
SOFT_M_PER_N = 0.1
WEIGHT = Weight((1.0, -0.97), (1.0, -0.9))
SPEEDS = (0.188, 0.03, 0.0)
STAYS = ((4, 12), (6, 20), (2, 8))
"""Speeds in m/s and their shortest and longest stays in samples, as `omni-paces` has them at 0.05 s."""


def materials() -> dict[str, Any]:
    """Return the numbers of couplers for each material, of weights, of the search of (6.15), and of 6.6."""
    return {**_jump(), **_own(), **_search(), **_later()}


def _jump() -> dict[str, Any]:
    """A press behind a compliant coupler, released behind a stiff one, over one material."""
    pair = static_coupler(SOFT_M_PER_N), wave_coupler(PERIOD_S, B, 0)
    contact, total, before = Contact(Wall(), PERIOD_S), 0.0, 0.0
    way = np.linspace(0.0, DEPTH_M, 400).tolist()
    for coupler, positions in zip(pair, (way, way[::-1])):
        for position in positions:
            total += contact.press(position, coupler.taps_m_per_n[0]) * (position - before)
            before = position
    own = sparing(MATERIALS, WAVE, PERIOD_S)
    handed, least = Contact(Wall(materials=own), PERIOD_S), 0.0
    rng = np.random.default_rng(6)
    for position in rng.normal(0.5 * DEPTH_M, DEPTH_M, 4000).tolist():
        held, port = handed.energy_j, handed.port_m
        handed.change(int(rng.integers(3)))
        least = min(least, handed.press(position, SOFT_M_PER_N) * (handed.port_m - port) - handed.energy_j + held)
    each = "meet (6.9)" if all(meets_printed_condition(c, B) for c in pair) else "miss (6.9)"
    return {"jump": total, "handed": least, "each": each}


def _own() -> dict[str, Any]:
    """One coupler and one for each material, at 1 kHz and at the published period."""
    felt, distorted, verdicts = [], [], []
    for name in ("omni-1khz", "omni-materials"):
        loop = compose(load_experiment(name, []))
        if not isinstance(loop.controller, WallController) or loop.verdict is None:
            raise HilError(f"{name}: renders no wall")
        coupler, wall = loop.controller.coupler, loop.controller.wall
        delay, period = loop.model.tau_max + loop.model.d_max, loop.model.period_s
        felt.append(np.array([felt_n_per_m(m, coupler) for m in wall.materials]))
        distorted.append(np.array([
            hinf_norm(distortion([m], [[1.0]], coupler, period_s=period, delay=delay, cutoff_hz=CUTOFF_HZ))
            for m in wall.materials
        ]))  # fmt: skip
        verdicts.append(loop.verdict.state)
    ceiling = ceiling_n_per_m(PERIOD_S, B, DELAY)
    published = [felt_n_per_m(sparing(MATERIALS, WAVE, PERIOD_S)[0], WAVE), felt_n_per_m(MATERIALS[0], WAVE)]
    weighed, plain = (stiffest_coupler(range(7), period_s=0.001, damping_n_s_per_m=7.0, weight=w) for w in (WEIGHT, None))
    return {
        "stiffer": float((felt[1] / felt[0]).min()), "clearer": float((distorted[1] / distorted[0]).max()), "own": verdicts[1],
        "felt": felt[1], "one": felt[0], "of_ceiling": published[0] / ceiling, "one_of_ceiling": published[1] / ceiling,
        "weighed": WEIGHT.peak(weighed.coupler) / WEIGHT.peak(plain.coupler),
        "softer": plain.stiffness_n_per_m / weighed.stiffness_n_per_m,
    }  # fmt: skip


def _search() -> dict[str, Any]:
    """The level that (6.14) gives to three triples (A_c, B_c, C_c), and the norm of the system that it stands for."""
    triples = WAVE, Coupler(taps_m_per_n=tuple(2.0 * c for c in WAVE.taps_m_per_n)), safe_coupler()
    printed = [hinf_norm(printed_distortion(MATERIALS, LAMBDA, c, cutoff_hz=CUTOFF_HZ)) for c in triples]
    meant = [distortion_norm(c, CUTOFF_HZ) for c in triples]
    return {"levels": max(printed) - min(printed), "norms": max(meant) / min(meant)}


def _later() -> dict[str, Any]:
    """Damping over the workspace, a delay that varies, and a sliding speed that varies."""

    def state(name: str, *sets: str) -> str:
        verdict = compose(load_experiment(name, [*sets, "allow_uncertified=true"])).verdict
        return "none" if verdict is None else verdict.state

    zones = "plant.zones=[{from_m=0.02,damping=1.9},{from_m=0.05,damping=3.0}]"
    ages = '{kind="markov",ages=[1,2],matrix=[[0.8,0.2],[0.6,0.4]]}'
    random = (f"network.sc.law={ages}", "network.ca.law={kind='constant',age=1}")
    moving = stiffest_coupler(lags([1, 2], [1]), period_s=PERIOD_S, damping_n_s_per_m=B, varying=True)
    chain, material = paced_chain(
        square_rows(SIDE_M), 3, [speed * PERIOD_S for speed in SPEEDS],
        [[0.0] * (least - 1) + [1.0 / (most - least + 1)] * (most - least + 1) for least, most in STAYS],
    )  # fmt: skip
    loop = loop_of(safe_coupler())
    return {
        "zones": state("omni-push", zones), "for_b": state("omni-push", zones, f"controller.coupler.damping_n_s_per_m={B}"),
        "moving": state("omni-push", *random, 'controller.coupler={method="stiffest",varying=true}'),
        "each_held": state("omni-push", *random, 'controller.coupler={method="stiffest"}'),
        "waiting": 1.0 / moving.stiffness_n_per_m / wave_coupler(PERIOD_S, B, 3).static_compliance_m_per_n,
        "paced": loop.jump_system([MATERIALS[m] for m in material], chain, DELAY, 0).radius(), "modes": len(material),
        "paces": state("omni-paces"),
    }  # fmt: skip


# fmt: off
OWN = (
    statement(
        "6.4: couplers C_i, each of which meets (6.9), are safe over a mixed wall", "Theorem 6.1 for each i",
        above("energy that a press behind one and a release behind the other absorb, J,", "jump", -1e-9),
        witness=(
            says("both couplers", "each", "meet (6.9)"), below("that energy", "jump", -0.01),
            above("least surplus where C_i = C - s_i and what is stored is handed over, J,", "handed", -1e-9),
        ),
        basis=f"{DEPTH_M:g} m into material 1, {SOFT_M_PER_N:g} m/N and T/(2 b): couplers that jump under pressure give energy",
    ),
    statement(
        "6.4: a coupler for each material is more transparent than one for all", "C_i(z), i = 1 .. N",
        says("verdict on C_i = C - s_i", "own", "certified"),
        above("least ratio of the stiffness felt to that with one coupler", "stiffer", 1),
        below(f"largest ratio of the distortion (6.12), weight of {CUTOFF_HZ:g} Hz,", "clearer", 1),
        exactly("stiffness felt at the published period over its ceiling, wave coupler,", "of_ceiling", 1, 2e-3),
        basis="omni-materials beside omni-1khz: {felt[0]:.0f}, {felt[1]:.0f}, {felt[2]:.0f} N/m felt, with one coupler "
        "{one[0]:.0f}, {one[1]:.0f}, {one[2]:.0f}; s_i = 1/(K_i + 2 B_i/T). At 0.05 s one coupler reaches "
        "{one_of_ceiling:.4f} of the ceiling",
    ),
    statement(
        "6.4: a weighting function maximises transparency at its frequencies", "W(z)",
        below("largest |W C| of the weighted design over that of the stiffest", "weighed", 1),
        above("static stiffness of the stiffest over that of the weighted design", "softer", 1),
        basis="W = (1 - 0.97/z)/(1 - 0.9/z), 1 kHz, delays 0 to 6, 7 N s/m: with the taps free the problem is convex",
    ),
    statement(
        "(6.15): the least level over the sets Omega_eta is the best coupler", "min gamma",
        above("how far apart (6.14) puts three triples, N/m,", "levels", 1e-9),
        witness=(below("that distance", "levels", 1e-9), above("largest norm of Figure 6.6 over the smallest", "norms", 1.02)),
        basis=f"wave coupler, twice it, the stiffest for 0 to 8 samples; weight of {CUTOFF_HZ:g} Hz: the search has no guide",
    ),
)
LATER = (
    statement(
        "6.6: damping that changes over the workspace", "worst b",
        says("coupler for the least of 1.9857, 1.9 and 3 N s/m", "zones", "certified"),
        says("coupler for 1.9857 N s/m", "for_b", "undecided"),
        basis="omni-push with two zones; sum u w >= b_min sum w^2 is all that the proof uses",
    ),
    statement(
        "6.6: a random delay, certified without equalising", "random delays",
        says("coupler for delays of 2 and 3 samples in any order", "moving", "certified"),
        says("coupler for each of them held", "each_held", "undecided"),
        above("its compliance over that of waiting for the largest", "waiting", 1),
        basis="a sufficient condition: the sum of all pairs of delays instead of the largest",
    ),
    statement(
        "6.6: a sliding speed that varies as a semi-Markov process", "Lambda(nu)",
        below("second-moment radius of the loop in contact", "paced", 1),
        says("verdict on omni-paces", "paces", "certified"),
        basis="{modes} modes of speed, stay and material; 0.188, 0.03 and 0 m/s, the stiffest coupler for 0 to 8 samples",
    ),
)
# fmt: on
