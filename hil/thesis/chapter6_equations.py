"""Equations and statements of Chapter 6 beside its theorem: device, loop, block diagrams, delays, (6.7), (6.15), (6.16)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from design.as_printed.chapters_5_and_6 import DELAY, LAMBDA, PERIOD_S, meets_printed_attenuation, meets_printed_condition
from design.controllers.rendered_wall import Coupler, WallController, static_coupler, wave_coupler
from design.controllers.wall import MATERIALS, Contact, Material, Wall
from design.controllers.wall_pattern import Patch, Pattern, material_chain, square_rows
from design.jump_linear.bounded_real import hinf_norm
from design.passivity import HapticLoop, HeldDevice, push_response
from design.passivity.condition import damping_needed
from design.passivity.synthesis import ceiling_n_per_m, stiffest_coupler
from design.passivity.transparency import distortion
from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.runtime.virtual import simulate
from hil.thesis.statements import above, below, exactly, says, statement
from plants.omni import Omni

CUTOFF_HZ = 0.3
LEVEL_N_PER_M = 0.06
DISTINGUISHABLE = 0.01
"""Relative difference of two stiffnesses below which they cannot be distinguished."""

SIDE_M = 0.02
STEP_M = 0.15 * math.pi * SIDE_M
"""Of the squares of the wall's pattern, and of the avatar in a sample."""


DEVICE = HeldDevice(mass_kg=Omni().inertia, damping_n_s_per_m=Omni().damping)
"""The device of (6.2) without a hand."""

B = DEVICE.damping_n_s_per_m
WAVE = wave_coupler(PERIOD_S, B, DELAY)

TIP_M = 0.135
"""From joint to tip of the device, m (`Omni.lever_m`)."""

READINGS: dict[str, tuple[Material, ...]] = {
    "at the tip, in m": MATERIALS,
    "at the joint, in rad": tuple(
        replace(m, stiffness_n_per_m=m.stiffness_n_per_m * TIP_M**2, damping_n_s_per_m=m.damping_n_s_per_m * TIP_M**2)
        for m in MATERIALS
    ),
}
"""The walls as the device meets them: (6.1) maps a torque to an angle, (6.2) and 6.5 have kg, N s/m and N/m."""


def bare_n_s_per_m(materials: Sequence[Material]) -> float:
    """Return the least K_i T/2 + |B_i|, the damping that a wall needs without a coupler, in N s/m."""
    return min(m.stiffness_n_per_m * PERIOD_S / 2 + m.damping_n_s_per_m for m in materials)


def loop_of(coupler: Coupler, device: HeldDevice = DEVICE) -> HapticLoop:
    """Return the published loop, three samples of delay on each side, with a coupler."""
    return HapticLoop(device=device, coupler=coupler, period_s=PERIOD_S, sc_max=DELAY, ca_max=0)


def safe_coupler() -> Coupler:
    """Return the stiffest coupler for 0 to 8 samples of delay."""
    return stiffest_coupler(range(9), period_s=PERIOD_S, damping_n_s_per_m=B).coupler


def distortion_norm(coupler: Coupler, cutoff_hz: float, *, mixed: bool = True) -> float:
    """Return the distortion (6.12) of the published loop, N/m, over the mixed wall under Lambda, or over material 1 alone."""
    materials, law = (MATERIALS, LAMBDA) if mixed else (MATERIALS[:1], ((1.0,),))
    return hinf_norm(distortion(materials, law, coupler, period_s=PERIOD_S, delay=DELAY, cutoff_hz=cutoff_hz))


def equations() -> dict[str, Any]:
    """Return the numbers of (6.1), (6.4) to (6.6), (6.8), Lambda, Remark 6.2, Figures 6.5 and 6.6, (6.17) and the delays."""
    A, pushed = DEVICE.discretise(100.0)
    law = np.array(LAMBDA)
    apart = Pattern(
        width_m=0.04, height_m=0.08,
        patches=tuple(Patch(y_m=0.0, z_m=0.02 * i, width_m=0.04, height_m=0.02, material=m) for i, m in enumerate((0, 2, 1, 2))),
    )  # fmt: skip
    zeros = material_chain(apart, 3, 0.002)
    printed = meets_printed_attenuation(MATERIALS, LAMBDA, WAVE, cutoff_hz=CUTOFF_HZ, gamma=LEVEL_N_PER_M)
    meant = distortion_norm(WAVE, CUTOFF_HZ)
    ceiling = ceiling_n_per_m(PERIOD_S, B, DELAY)
    felt = [[1.0 / (1.0 / m.stiffness_n_per_m + 1.0 / ceiling) for m in materials] for materials in READINGS.values()]
    return {
        "far": float(np.abs(np.linalg.eigvals(A)).max()), "angle": float(pushed[0]),
        "rows": float(np.abs(law.sum(axis=1) - 1.0).max()), "entry": float(law.min()),
        "touch": float(zeros[0, 1] + zeros[1, 0]),
        "radius": loop_of(WAVE).jump_system(MATERIALS, zeros, DELAY, 0).radius(),
        **_closed_loop(), "force": max(map(_force_error, range(3))), "split": _split_error(WAVE.taps_m_per_n),
        "certifies": "certifies" if printed else "does not certify", "share": LEVEL_N_PER_M / meant, "norm": meant,
        "felt": [(first - second) / first for first, second, _ in felt], "ceiling": ceiling,
    }  # fmt: skip


def _closed_loop() -> dict[str, float]:
    """The rig that runs, beside the matrices of (6.4) to (6.6) with both delays."""
    experiment = load_experiment("omni-push", [])
    loop = compose(experiment)
    if not isinstance(loop.controller, WallController):
        raise HilError("omni-push: renders no wall")
    run = simulate(loop, experiment.seed).arrays["/plant/state"]["position"]
    tau, d = loop.model.tau_max, loop.model.d_max
    closed = HapticLoop(device=DEVICE, coupler=loop.controller.coupler, period_s=loop.model.period_s, sc_max=tau, ca_max=d)
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
    statement(
        "(6.1): the joint by itself is unstable", "an integrator",
        exactly("spectral radius over 100 s", "far", 1, 1e-12), above("angle after 100 s of 1 N m, rad,", "angle", 10),
        basis="bounded input, unbounded output",
    ),
    statement(
        "6.2.2: lambda_ii = 1 - sum lambda_ij", "a transition matrix",
        exactly("largest |row sum - 1| of the printed Lambda", "rows", 0, 1e-12), above("smallest entry", "entry", 0),
    ),
    statement(
        "Remark 6.2: materials that do not touch give 0 in Lambda, which the design allows", "lambda_ij = lambda_ji = 0",
        exactly("lambda_12 + lambda_21 of strips 1 3 2 3", "touch", 0, 1e-15),
        below("second-moment radius under that Lambda", "radius", 1),
        basis="the wave coupler for six samples, no hand",
    ),
    statement(
        "(6.4) to (6.6), tau1 = tau2 = 3 T = 0.15 s", "x/f = M/(1 + M C_o)",
        exactly("largest difference of the rig from the closed loop, um,", "rig", 0, 1.0, "largest"),
        exactly("delay of each direction, s", "delay", 0.15, 1e-12),
        basis="omni-push, 1 N, 800 slots over the emulated network; packets carry single precision",
    ),
    statement(
        "(6.8): force of a material", "K x + B x'",
        exactly("largest difference of the wall that runs, N,", "force", 0, 1e-9),
        basis="presses of 1 and 2 mm into each material, without a coupler",
    ),
    statement(
        "Figures 6.5, 6.6: taking D_c out of C changes nothing", "the same",
        exactly("largest relative difference of the responses", "split", 0, 1e-12),
        basis="G/(1 + G C) beside the loop of G/(1 + G D_c) and the rest of C, 200 angles, each material",
    ),
    statement(
        "(6.17): a level gamma that it certifies bounds the distortion", "|z| < gamma |omega|",
        above(f"{LEVEL_N_PER_M:g} N/m, which it {{certifies}}, over the norm", "share", 1),
        witness=(
            says(f"(6.17) at {LEVEL_N_PER_M:g} N/m", "certifies", "certifies"),
            above("norm of the system of Figure 6.6, N/m,", "norm", 1e4 * LEVEL_N_PER_M),
        ),
        basis=f"wave coupler, weight of {CUTOFF_HZ:g} Hz, D_w = 0, Lambda, six samples",
    ),
    statement(
        "6.5.2: it is clear that different parts of the wall have different stiffness", "1000 and 800 N/m",
        *(
            above(f"relative difference of the stiffness felt, {reading},", f"felt[{n}]", DISTINGUISHABLE)
            for n, reading in enumerate(READINGS)
        ),
        readings=True,
        basis="a rendering that is safe for every passive hand has at most {ceiling:.4g} N/m, or N m/rad; the units of (6.1) and "
        "(6.2) contradict each other",
    ),
)
# fmt: on
ABSENT_M_PER_N = 100.0
"""Compliance of a coupler behind which there is next to no wall."""
RUNS, SLOTS = 20, 400


def statements() -> dict[str, Any]:
    """Return the numbers of Remark 6.1, Sections 6.2.2 and 6.3, (6.7), Section 6.4, (6.15), (6.16) and Section 6.6."""
    pattern = square_rows(SIDE_M)
    once, slower = (material_chain(pattern, 3, step) for step in (STEP_M, STEP_M / 2))
    repeated = material_chain(_repeated(pattern), 3, STEP_M)
    leaving = (1.0 - np.diag(slower)) / (1.0 - np.diag(once))
    needed = damping_needed(safe_coupler(), PERIOD_S, range(9)).damping_n_s_per_m
    absent = static_coupler(ABSENT_M_PER_N)
    proper = Coupler(taps_m_per_n=(PERIOD_S / (2.0 * B), -0.05))
    return {
        "b": B, "least_b": 0.99 * B, "needed": needed, "repeated": float(np.abs(repeated - once).max()), "leaving": leaving,
        "least": leaving.min(), "most": leaving.max(), "ages": _equalised(),
        "bare": bare_n_s_per_m(MATERIALS),
        "nearer": distortion_norm(absent, 3.0, mixed=False) / distortion_norm(WAVE, 3.0, mixed=False),
        "farther": ABSENT_M_PER_N / WAVE.static_compliance_m_per_n,
        "meets": "meets (6.9)" if meets_printed_condition(proper, B) else "misses (6.9)", **_attenuation(WAVE),
    }  # fmt: skip


def _repeated(pattern: Pattern) -> Pattern:
    w, h = pattern.width_m, pattern.height_m
    patches = tuple(
        Patch(y_m=p.y_m + i * w, z_m=p.z_m + j * h, width_m=p.width_m, height_m=p.height_m, material=p.material)
        for i in (0, 1) for j in (0, 1) for p in pattern.patches
    )  # fmt: skip
    return Pattern(width_m=2 * w, height_m=2 * h, patches=patches)


def _equalised() -> float:
    """Largest difference of a rig over random ages and over constant ones, m."""
    found = []
    for sets in ([], ['network.sc.law={kind="constant", age=5}', 'network.ca.law={kind="constant", age=5}']):
        experiment = load_experiment("omni-wifi", sets, duration="6 s")
        found.append(simulate(compose(experiment, certify=False), experiment.seed).arrays["/plant/state"]["position"])
    return float(np.abs(found[0] - found[1]).max())


def _attenuation(coupler: Coupler) -> dict[str, float]:
    """The level gamma of (6.16) beside what random motions and materials give."""
    system = distortion(MATERIALS, LAMBDA, coupler, period_s=PERIOD_S, delay=DELAY, cutoff_hz=CUTOFF_HZ)
    gamma, rng, law = hinf_norm(system), np.random.default_rng(6), np.array(LAMBDA)
    A, E, C = (np.asarray(m, np.float64) for m in (system.A, system.B, system.C))
    ratios = []
    for _ in range(RUNS):
        x, mode, gave, took = np.zeros(A.shape[1]), int(rng.integers(3)), 0.0, 0.0
        frequency = rng.uniform(0.0, math.pi)
        for k in range(SLOTS):
            omega = math.cos(frequency * k)
            gave, took = gave + float(((C[mode] @ x) ** 2).sum()), took + omega * omega
            x = A[mode] @ x + E[mode, :, 0] * omega
            mode = int(rng.choice(3, p=law[mode]))
        ratios.append(math.sqrt(gave / took))
    return {"ratio": max(ratios), "share": max(ratios) / gamma, "gamma": gamma}


# fmt: off
STATEMENTS = (
    statement(
        "Remark 6.1: the rates of one patch are those of every patch of its material", "a repeated pattern",
        exactly("largest difference of Lambda over one cell and over two by two", "repeated", 0, 1e-12),
        basis="the pattern of Figure 6.2 as rows of squares between strips",
    ),
    statement(
        "6.2.2: with a time-varying speed Lambda varies too", "lambda_ij(nu) in proportion to nu",
        exactly("least chance to leave a material at half the speed over that at full speed", "least", 0.5, 1e-9),
        exactly("largest", "most", 0.5, 1e-9),
        basis="the same pattern",
    ),
    statement(
        "6.3: constant delays can be used to model some types of networks", "certain protocols",
        exactly("largest difference of the rig over random ages of 1 to 5 and over constant ages of 5, m,", "ages", 0, 1e-15),
        basis="omni-wifi: both ends wait until the largest delay has passed, and the packet carries a row for every age",
    ),
    statement(
        "6.3: a coupler allows a larger T and more of K_i and B_i", "no b > K_i T/2 + |B_i|",
        below("damping that the wall needs with the coupler, N s/m,", "needed", "b"),
        above("without one, N s/m,", "bare", "b"),
        basis="the stiffest coupler for 0 to 8 samples of delay, for any passive wall and hand; metre reading",
    ),
    statement(
        "(6.7): it is equivalent to the least distortion", "the same minimum",
        above("distortion of next to no wall over that of a safe coupler", "nearer", 1),
        witness=(below("that ratio", "nearer", 1), above("ratio of how far the device is from x_d under 1 N", "farther", 1)),
        basis=f"wave coupler beside {ABSENT_M_PER_N:g} m/N, material 1, weight of 3 Hz: what distorts less errs more",
    ),
    statement(
        "6.4: a coupler of this form satisfies Theorem 6.1", "C_bar strictly proper",
        says("T/(2 b) - 0.05 z^-1", "meets", "meets (6.9)"), witness=(says("T/(2 b) - 0.05 z^-1", "meets", "misses (6.9)"),),
        basis="C_bar = -0.05 z^-1 m/N is strictly proper, d = 0 and D_c = T/(2 b)",
    ),
    statement(
        "(6.15), (6.16): a level gamma bounds |z| over |omega|", "|z| < gamma |omega|",
        below("largest |z|/|omega| over the exact norm", "share", 1), above("largest |z|/|omega|, N/m,", "ratio", 1),
        basis=f"{RUNS} motions of one frequency each, {SLOTS} slots under Lambda; wave coupler, weight of {CUTOFF_HZ:g} Hz, "
        "norm {gamma:.4g} N/m",
    ),
    statement(
        "6.6: the coupler depends on the damping b of the device", "b may change in the workspace",
        above("damping that the coupler for b needs", "needed", "least_b"), below("that damping", "needed", "b"),
        basis="the stiffest coupler: a device with 1 % less damping has no certificate",
    ),
)
# fmt: on
