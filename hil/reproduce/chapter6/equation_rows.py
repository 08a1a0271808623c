"""Equations and remarks of Chapter 6 that are not claims of a theorem: device, wall, loop, block diagrams, delays."""

from __future__ import annotations

from typing import Any

import numpy as np

from design.as_printed.chapter6 import DELAY, LAMBDA, PERIOD_S, printed_attenuation
from design.controllers.rendered_wall import WallController, wave_coupler
from design.controllers.wall import MATERIALS, Contact, Wall
from design.controllers.wall_pattern import Patch, Pattern
from design.jump_linear.bounded_real import hinf_norm
from design.passivity.loop import HapticLoop, HeldDevice, push_response
from design.passivity.material_chain import material_chain
from design.passivity.synthesis import ceiling_n_per_m
from design.passivity.transparency import distortion
from hil.compose.loop import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.reproduce.statements import Statement, above, below, exactly, says
from hil.session import simulate

CUTOFF_HZ = 0.3
LEVEL_N_PER_M = 0.06
TOLD_APART = 0.01
"""Relative difference of two stiffnesses below which they cannot be told apart."""


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
    moved = HapticLoop(device=device, coupler=wave, period_s=PERIOD_S, sc_max=DELAY, ca_max=0)
    printed = printed_attenuation(MATERIALS, LAMBDA, wave, cutoff_hz=CUTOFF_HZ, gamma=LEVEL_N_PER_M)
    meant = hinf_norm(distortion(MATERIALS, LAMBDA, wave, period_s=PERIOD_S, delay=DELAY, cutoff_hz=CUTOFF_HZ))
    ceiling = ceiling_n_per_m(PERIOD_S, device.damping_n_s_per_m, DELAY)
    felt = [1.0 / (1.0 / m.stiffness_n_per_m + 1.0 / ceiling) for m in MATERIALS]
    return {
        "far": float(np.abs(np.linalg.eigvals(A)).max()), "angle": float(B[0]),
        "rows": float(np.abs(law.sum(axis=1) - 1.0).max()), "entry": float(law.min()),
        "touch": float(zeros[0, 1] + zeros[1, 0]), "radius": moved.jump_system(MATERIALS, zeros, DELAY, 0).radius(),
        **_closed_loop(device), "force": max(map(_force_error, range(3))), "split": _split_error(wave.taps_m_per_n),
        "certifies": "certifies" if printed.holds else "does not certify", "share": LEVEL_N_PER_M / meant, "norm": meant,
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
        (above("relative difference of the stiffness felt", "felt", TOLD_APART),),
        (below("that difference", "felt", TOLD_APART),),
        basis="metre reading: a rendering that is safe for every passive hand is at most {ceiling:.4g} N/m stiff",
    ),
)
# fmt: on
