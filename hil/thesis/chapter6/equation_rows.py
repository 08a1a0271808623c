"""Equations and remarks of Chapter 6 that are not claims of a theorem: device, mixed wall, loop, block diagrams, delays.

Of the mixed wall (Section 6.2.2): its transition matrix, and the assumption that sliding has no memory.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import groupby, islice
from typing import Any

import numpy as np
from scipy.stats import chi2

from design.as_printed.chapter6 import DELAY, LAMBDA, PERIOD_S, meets_printed_attenuation
from design.controllers.rendered_wall import Coupler, WallController, wave_coupler
from design.controllers.wall import MATERIALS, Contact, Wall
from design.controllers.wall_pattern import Patch, Pattern, square_rows
from design.jump_linear.bounded_real import hinf_norm
from design.passivity.loop import HapticLoop, HeldDevice, push_response
from design.passivity.material_chain import boundaries, material_chain, memory_statistic, true_chain
from design.passivity.synthesis import ceiling_n_per_m, stiffest_coupler
from design.passivity.transparency import distortion
from hil.compose.loop import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.runtime.virtual import simulate
from hil.thesis.statements import Statement, above, below, exactly, says

CUTOFF_HZ = 0.3
LEVEL_N_PER_M = 0.06
DISTINGUISHABLE = 0.01
"""Relative difference of two stiffnesses below which they cannot be distinguished."""


SIDE_M = 0.02
STEP_M = 0.15 * math.pi * SIDE_M
"""Of the squares of the wall's pattern, and of the avatar in a sample."""


def loop_of(device: HeldDevice, coupler: Coupler) -> HapticLoop:
    """Return the published loop, three samples of delay on each side, with a coupler."""
    return HapticLoop(device=device, coupler=coupler, period_s=PERIOD_S, sc_max=DELAY, ca_max=0)


def safe_coupler(device: HeldDevice) -> Coupler:
    """Return the stiffest coupler for 0 to 8 samples of delay."""
    return stiffest_coupler(range(9), period_s=PERIOD_S, damping_n_s_per_m=device.damping_n_s_per_m).coupler


def distortion_norm(coupler: Coupler, cutoff_hz: float, *, mixed: bool = True) -> float:
    """Return the distortion (6.12) of the published loop, N/m, over the mixed wall under Lambda, or over material 1 alone."""
    materials, law = (MATERIALS, LAMBDA) if mixed else (MATERIALS[:1], ((1.0,),))
    return hinf_norm(distortion(materials, law, coupler, period_s=PERIOD_S, delay=DELAY, cutoff_hz=cutoff_hz))


def equations(device: HeldDevice) -> dict[str, Any]:
    """Return the numbers of (6.1), (6.4) to (6.6), (6.8), Lambda, Remark 6.2, Figures 6.5 and 6.6, (6.17) and the delays.

    Args:
        device: the device of (6.2) without a hand.
    """
    A, B = device.discretise(100.0)
    law = np.array(LAMBDA)
    apart = Pattern(
        width_m=0.04, height_m=0.08,
        patches=tuple(Patch(y_m=0.0, z_m=0.02 * i, width_m=0.04, height_m=0.02, material=m) for i, m in enumerate((0, 2, 1, 2))),
    )  # fmt: skip
    zeros = material_chain(apart, 3, 0.002)
    wave = wave_coupler(PERIOD_S, device.damping_n_s_per_m, DELAY)
    printed = meets_printed_attenuation(MATERIALS, LAMBDA, wave, cutoff_hz=CUTOFF_HZ, gamma=LEVEL_N_PER_M)
    meant = distortion_norm(wave, CUTOFF_HZ)
    ceiling = ceiling_n_per_m(PERIOD_S, device.damping_n_s_per_m, DELAY)
    felt = [1.0 / (1.0 / m.stiffness_n_per_m + 1.0 / ceiling) for m in MATERIALS]
    return {
        "far": float(np.abs(np.linalg.eigvals(A)).max()), "angle": float(B[0]),
        "rows": float(np.abs(law.sum(axis=1) - 1.0).max()), "entry": float(law.min()),
        "touch": float(zeros[0, 1] + zeros[1, 0]),
        "radius": loop_of(device, wave).jump_system(MATERIALS, zeros, DELAY, 0).radius(),
        **_closed_loop(device), "force": max(map(_force_error, range(3))), "split": _split_error(wave.taps_m_per_n),
        "certifies": "certifies" if printed else "does not certify", "share": LEVEL_N_PER_M / meant, "norm": meant,
        "felt": (felt[0] - felt[1]) / felt[0], "ceiling": ceiling,
    }  # fmt: skip


def _closed_loop(device: HeldDevice) -> dict[str, float]:
    """The rig that runs, beside the matrices of (6.4) to (6.6) with both delays."""
    experiment = load_experiment("omni-push", [])
    loop = compose(experiment)
    if not isinstance(loop.controller, WallController):
        raise HilError("omni-push: renders no wall")
    run = simulate(loop, experiment.seed).arrays["/plant/state"]["position"]
    tau, d = loop.model.tau_max, loop.model.d_max
    closed = HapticLoop(device=device, coupler=loop.controller.coupler, period_s=loop.model.period_s, sc_max=tau, ca_max=d)
    there = push_response(closed, MATERIALS[0], tau, d, 1.0, len(run) - 1)
    return {
        "rig": 1e6 * float(np.abs(run - there).max()), "largest": 1e6 * float(np.abs(there).max()),
        "delay": experiment.network.sc.max_age * float(experiment.period),
    }  # fmt: skip


def _force_error(i: int) -> float:
    wall = Wall(material=i)
    contact, before, worst = Contact(wall, PERIOD_S, i), 0.0, 0.0
    for position_m in (1e-3, 1e-3, 2e-3):
        force = contact.press(position_m, 0.0)
        speed = (position_m - before) / PERIOD_S
        worst = max(worst, abs(force - MATERIALS[i].stiffness_n_per_m * position_m - MATERIALS[i].damping_n_s_per_m * speed))
        before = position_m
    return worst


def _split_error(taps: tuple[float, ...]) -> float:
    z = np.exp(1j * np.pi * np.arange(1, 201) / 200)
    rest = np.asarray(sum(c * z**-l for l, c in enumerate(taps) if l))
    worst = 0.0
    for m in MATERIALS:
        g = m.stiffness_n_per_m + m.damping_n_s_per_m * (z - 1) / (PERIOD_S * z)
        inner = g / (1 + g * taps[0])
        whole = g / (1 + g * (taps[0] + rest))
        worst = max(worst, float((np.abs(inner / (1 + inner * rest) - whole) / np.abs(whole)).max()))
    return worst


# fmt: off
EQUATIONS = (
    Statement(
        "(6.1): the joint by itself is unstable", "an integrator",
        (exactly("spectral radius over 100 s", "far", 1, 1e-12), above("angle after 100 s of 1 N m, rad,", "angle", 10)),
        basis="bounded input, unbounded output",
    ),
    Statement(
        "6.2.2: lambda_ii = 1 - sum lambda_ij", "a transition matrix",
        (exactly("largest |row sum - 1| of the printed Lambda", "rows", 0, 1e-12), above("smallest entry", "entry", 0)),
    ),
    Statement(
        "Remark 6.2: materials that do not touch give 0 in Lambda, which the design allows", "lambda_ij = lambda_ji = 0",
        (
            exactly("lambda_12 + lambda_21 of strips 1 3 2 3", "touch", 0, 1e-15),
            below("second-moment radius under that Lambda", "radius", 1),
        ),
        basis="the wave coupler for six samples, no hand",
    ),
    Statement(
        "(6.4) to (6.6), tau1 = tau2 = 3 T = 0.15 s", "x/f = M/(1 + M C_o)",
        (
            exactly("largest difference of the rig from the closed loop, um,", "rig", 0, 1.0, "largest"),
            exactly("delay of each direction, s", "delay", 0.15, 1e-12),
        ),
        basis="omni-push, 1 N, 800 slots over the emulated network; packets carry single precision",
    ),
    Statement(
        "(6.8): force of a material", "K x + B x'",
        (exactly("largest difference of the wall that runs, N,", "force", 0, 1e-9),),
        basis="presses of 1 and 2 mm into each material, without a coupler",
    ),
    Statement(
        "Figures 6.5, 6.6: taking D_c out of C changes nothing", "the same",
        (exactly("largest relative difference of the responses", "split", 0, 1e-12),),
        basis="G/(1 + G C) beside the loop of G/(1 + G D_c) and the rest of C, 200 angles, each material",
    ),
    Statement(
        "(6.17): a level gamma that it certifies bounds the distortion", "|z| < gamma |omega|",
        (above(f"{LEVEL_N_PER_M:g} N/m, which it {{certifies}}, over the norm", "share", 1),),
        (
            says(f"(6.17) at {LEVEL_N_PER_M:g} N/m", "certifies", "certifies"),
            above("norm of the system of Figure 6.6, N/m,", "norm", 1e4 * LEVEL_N_PER_M),
        ),
        basis=f"wave coupler, weight of {CUTOFF_HZ:g} Hz, D_w = 0, Lambda, six samples",
    ),
    Statement(
        "6.5.2: it is clear that different parts of the wall have different stiffness", "1000 and 800 N/m",
        (above("relative difference of the stiffness felt", "felt", DISTINGUISHABLE),),
        (below("that difference", "felt", DISTINGUISHABLE),),
        basis="metre reading: a rendering that is safe for every passive hand is at most {ceiling:.4g} N/m stiff",
    ),
)
# fmt: on


MODES_610 = (1, 2, 1, 2, 1, 0)  # {2, 3, 2, 3, 2, 1}
LEVEL = 1e-3


def wall() -> dict[str, Any]:
    """Return the numbers of Section 6.2.2 and of Figure 6.10."""
    pattern, printed = square_rows(SIDE_M), np.array(LAMBDA)
    lengths, areas = boundaries(pattern, 3)
    leaving = 1.0 - np.diag(printed)
    statistic, freedom = memory_statistic(list(slide(0.35, 20_000)), 3)
    limit = float(chi2.isf(LEVEL, freedom))
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
    pattern = square_rows(SIDE_M)
    y, z = math.cos(heading) * step_m, math.sin(heading) * step_m
    return (pattern.material_at(1.5 * SIDE_M + k * y, 0.1 * SIDE_M + k * z) for k in range(samples))


def visits(heading: float) -> tuple[int, ...]:
    """Return the first six different materials of a straight slide, in fine steps."""
    return tuple(material for material, _ in islice(groupby(slide(heading, 2000, 0.02 * SIDE_M)), 6))


# fmt: off
WALL = (
    Statement(
        "6.5: Lambda from a pattern of patches", "0.4 0.3 0.3; 0.3 0.4 0.3; 0.15 0.15 0.7",
        (exactly("largest difference", "error", 0, 1e-12, "entry"),),
        basis="lambda_ij = nu T c_ij/(pi A_i) over rows of squares between strips, nu T = 0.15 pi w",
    ),
    Statement(
        "(6.3): lambda_ij in proportion to c_ij/sum c_ij and nu", "one factor for every i",
        (exactly("ratio of the probabilities with which Lambda leaves its materials", "apart", 1, 1e-9),),
        (above("that ratio", "apart", 1.0 + 1e-9),),
        basis="the printed rows of (6.3) sum to nu times one factor; the areas are missing from it",
    ),
    Statement(
        "6.5.2: material 3 is left less often, as its area is larger", "0.15 < 0.3",
        (
            exactly("distance of the area shares from the stationary law of Lambda", "balance", 0, 1e-12),
            above("area of material 3 over that of material 1", "areas", 1),
        ),
        basis="the same pattern; boundaries of {length:g} m each",
    ),
    Statement(
        "6.2.2: one step of the avatar follows Lambda", "Lambda",
        (below("distance of the exact one-step matrix of the geometry", "off", 0.02),),
        basis="uniform place and direction, nu T = 0.15 pi w; the linear law holds for short steps only",
    ),
    Statement(
        "6.1: the movement is independent of the past, so the material is a Markov process", "memoryless",
        (below(f"G on {{freedom}} degrees of freedom, level {LEVEL:g}:", "G", "limit"),), (above("G", "G", "far"),),
        basis="20,000 samples of a straight slide at the published speed",
    ),
    Statement(
        "Figure 6.10: the modes {2, 3, 2, 3, 2, 1}", "2 3 2 3 2 1",
        (says("a straight slide that shows them", "slide", "found"),),
        computed="heading {heading:.2f} degrees", basis="the same pattern, from within material 2, of 300 headings",
    ),
)
# fmt: on
