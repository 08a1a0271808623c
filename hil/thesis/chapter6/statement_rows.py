"""Statements of Chapter 6 beside its theorem: pattern, speed, the two minima, what a coupler is for, and what the rig shows.

The rig shows the identification of Section 6.2.1, and the slide of Figures 6.9 and 6.10.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from design.as_printed.chapter6 import DELAY, LAMBDA, PERIOD_S, meets_printed_condition
from design.controllers.rendered_wall import Coupler, WallController, static_coupler, wave_coupler
from design.controllers.wall import MATERIALS
from design.controllers.wall_pattern import Patch, Pattern, square_rows
from design.identification.axis import Record
from design.identification.output_error import identify_axis
from design.jump_linear.bounded_real import hinf_norm
from design.passivity.condition import damping_needed
from design.passivity.loop import HeldDevice
from design.passivity.material_chain import material_chain
from design.passivity.transparency import distortion
from hil.compose.loop import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.measure.view import APPLIED, MEASUREMENT, view_of
from hil.pages.html.figures import Figure, Series
from hil.runtime.virtual import simulate
from hil.session.replay.avatar import avatar_path, wall_loop_of
from hil.thesis.chapter import Plot
from hil.thesis.chapter6.equation_rows import SIDE_M, STEP_M, distortion_norm, safe_coupler
from hil.thesis.statements import Statement, above, below, exactly, mean, says, within

CUTOFF_HZ = 0.3
ABSENT_M_PER_N = 100.0
"""Compliance of a coupler behind which there is next to no wall."""
RUNS, SLOTS = 20, 400


def statements(device: HeldDevice) -> dict[str, Any]:
    """Return the numbers of Remark 6.1, Sections 6.2.2 and 6.3, (6.7), Section 6.4, (6.15), (6.16) and Section 6.6.

    Args:
        device: the device of (6.2) without a hand.
    """
    b = device.damping_n_s_per_m
    pattern = square_rows(SIDE_M)
    once, slower = (material_chain(pattern, 3, step) for step in (STEP_M, STEP_M / 2))
    repeated = material_chain(_repeated(pattern), 3, STEP_M)
    leaving = (1.0 - np.diag(slower)) / (1.0 - np.diag(once))
    wave = wave_coupler(PERIOD_S, b, DELAY)
    needed = damping_needed(safe_coupler(device), PERIOD_S, range(9)).damping_n_s_per_m
    absent = static_coupler(ABSENT_M_PER_N)
    proper = Coupler(taps_m_per_n=(PERIOD_S / (2.0 * b), -0.05))
    return {
        "b": b, "least_b": 0.99 * b, "needed": needed, "repeated": float(np.abs(repeated - once).max()), "leaving": leaving,
        "least": leaving.min(), "most": leaving.max(), "ages": _equalised(),
        "bare": min(m.stiffness_n_per_m * PERIOD_S / 2 + m.damping_n_s_per_m for m in MATERIALS),
        "nearer": distortion_norm(absent, 3.0, mixed=False) / distortion_norm(wave, 3.0, mixed=False),
        "farther": ABSENT_M_PER_N / wave.static_compliance_m_per_n,
        "meets": "meets (6.9)" if meets_printed_condition(proper, b) else "misses (6.9)", **_attenuation(wave),
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
        found.append(simulate(compose(experiment), 0).arrays["/plant/state"]["position"])
    return float(np.abs(found[0] - found[1]).max())


def _attenuation(coupler: Coupler) -> dict[str, float]:
    """The level gamma of (6.16) beside what random motions and materials give."""
    system = distortion(MATERIALS, LAMBDA, coupler, period_s=PERIOD_S, delay=DELAY, cutoff_hz=CUTOFF_HZ)
    gamma, rng, law = hinf_norm(system), np.random.default_rng(6), np.array(LAMBDA)
    A, B, C = (np.asarray(m, np.float64) for m in (system.A, system.B, system.C))
    ratios = []
    for _ in range(RUNS):
        x, mode, gave, took = np.zeros(A.shape[1]), int(rng.integers(3)), 0.0, 0.0
        frequency = rng.uniform(0.0, math.pi)
        for k in range(SLOTS):
            omega = math.cos(frequency * k)
            gave, took = gave + float(((C[mode] @ x) ** 2).sum()), took + omega * omega
            x = A[mode] @ x + B[mode, :, 0] * omega
            mode = int(rng.choice(3, p=law[mode]))
        ratios.append(math.sqrt(gave / took))
    return {"ratio": max(ratios), "share": max(ratios) / gamma, "gamma": gamma}


# fmt: off
STATEMENTS = (
    Statement(
        "Remark 6.1: the rates of one patch are those of every patch of its material", "a repeated pattern",
        (exactly("largest difference of Lambda over one cell and over two by two", "repeated", 0, 1e-12),),
        basis="the pattern of Figure 6.2 as rows of squares between strips",
    ),
    Statement(
        "6.2.2: with a time-varying speed Lambda varies too", "lambda_ij(nu) in proportion to nu",
        (
            exactly("least chance to leave a material at half the speed over that at full speed", "least", 0.5, 1e-9),
            exactly("largest", "most", 0.5, 1e-9),
        ),
        basis="the same pattern",
    ),
    Statement(
        "6.3: constant delays can be used to model some types of networks", "certain protocols",
        (exactly("largest difference of the rig over random ages of 1 to 5 and over constant ages of 5, m,", "ages", 0, 1e-15),),
        basis="omni-wifi: both ends wait until the largest delay has passed, and the packet carries a row for every age",
    ),
    Statement(
        "6.3: a coupler allows a larger T and more of K_i and B_i", "no b > K_i T/2 + |B_i|",
        (
            below("damping that the wall needs with the coupler, N s/m,", "needed", "b"),
            above("without one, N s/m,", "bare", "b"),
        ),
        basis="the stiffest coupler for 0 to 8 samples of delay, for any passive wall and hand",
    ),
    Statement(
        "(6.7): it is equivalent to the least distortion", "the same minimum",
        (above("distortion of next to no wall over that of a safe coupler", "nearer", 1),),
        (below("that ratio", "nearer", 1), above("ratio of how far the device is from x_d under 1 N", "farther", 1)),
        basis=f"wave coupler beside {ABSENT_M_PER_N:g} m/N, material 1, weight of 3 Hz: what distorts less errs more",
    ),
    Statement(
        "6.4: a coupler of this form satisfies Theorem 6.1", "C_bar strictly proper",
        (says("T/(2 b) - 0.05 z^-1", "meets", "meets (6.9)"),), (says("T/(2 b) - 0.05 z^-1", "meets", "misses (6.9)"),),
        basis="C_bar = -0.05 z^-1 m/N is strictly proper, d = 0 and D_c = T/(2 b)",
    ),
    Statement(
        "(6.15), (6.16): a level gamma bounds |z| over |omega|", "|z| < gamma |omega|",
        (below("largest |z|/|omega| over the exact norm", "share", 1), above("largest |z|/|omega|, N/m,", "ratio", 1)),
        basis=f"{RUNS} motions of one frequency each, {SLOTS} slots under Lambda; wave coupler, weight of {CUTOFF_HZ:g} Hz, "
        "norm {gamma:.4g} N/m",
    ),
    Statement(
        "6.6: the coupler depends on the damping b of the device", "b may change in the workspace",
        (above("damping that the coupler for b needs", "needed", "least_b"), below("that damping", "needed", "b")),
        basis="the stiffest coupler: a device with 1 % less damping has no certificate",
    ),
)
# fmt: on


TIP_M = 0.135
"""From joint to tip of the device, m (`Omni.lever_m`)."""


def identification() -> dict[str, Any]:
    """Return the numbers of (6.2)."""
    experiment = load_experiment("omni-identify", [])
    run = simulate(compose(experiment), experiment.seed)
    record = Record(
        u=run.arrays[APPLIED]["torque"], y=run.arrays[MEASUREMENT]["angle"], period_s=float(experiment.period)
    )
    fit = identify_axis([record])
    plain = "none" if fit.plain is None else f"m = {1.0 / fit.plain[0]:.3g}, b = {fit.plain[1] / fit.plain[0]:.3g}"
    return {"fit": fit, "plain": plain}


def slide() -> dict[str, Any]:
    """Return the numbers and the picture of Figures 6.9 and 6.10.

    Raises:
        HilError: the shipped experiment has no wall.
    """
    experiment = load_experiment("omni-slide", [])
    run = simulate(compose(experiment), experiment.seed)
    view = view_of(run, experiment)
    loop = wall_loop_of(view)
    path = avatar_path(view, loop) if loop is not None else None
    if path is None or loop is None or not isinstance(loop.controller, WallController):
        raise HilError("omni-slide: renders no wall")
    compliance = loop.controller.coupler.static_compliance_m_per_n
    way = float(np.hypot(np.diff(path.y_m), np.diff(path.z_m)).sum())
    deepest = float(path.depth_m.max())
    device = float(view.run.arrays[MEASUREMENT]["position"].max())
    pushed = float(compliance) + 1.0 / MATERIALS[0].stiffness_n_per_m
    panels = (
        Figure(
            title="6.9: depth of the avatar", y_label="depth", y_unit="mm",
            series=(Series(label="avatar", x=path.t_s, y=1e3 * path.depth_m),),
        ),
        Figure(
            title="6.10: material under it", y_label="material", integer_y=True,
            series=(Series(label="material", x=path.t_s, y=path.material + 1, style="step"),),
        ),
    )  # fmt: skip
    return {
        "way": way, "share": deepest / way, "deepest": 1e3 * deepest, "device": 1e3 * device, "pushed": 1e3 * pushed,
        "order": device / pushed, "arc": math.asin(device / TIP_M) * TIP_M / device - 1.0,
        "figures": (Plot(title="Figures 6.9 and 6.10", panels=panels),),
    }  # fmt: skip


# fmt: off
IDENTIFICATION = (
    Statement(
        "(6.2): m and b from a square wave of 0.4545 Hz and 0.02", "0.7943, 1.9857",
        (
            mean("m", "fit.inertia.value", "0.7943", error="fit.inertia.error", why="of the fit"),
            mean("b", "fit.damping.value", "1.9857", error="fit.damping.error", why="of the fit"),
            says("residuals", "fit.residuals.verdict", "white"),
        ),
        basis="the emulated joint has these numbers: what is reproduced is that the printed experiment finds them, with "
        "noise of 1e-3 on the encoder, by output error. Plain least squares: {plain}",
    ),
)
SLIDE = (
    Statement(
        "Figure 6.9: the avatar's displacement along x is very small", "very small",
        (below("deepest avatar over the length of its way", "share", 0.001), below("deepest avatar, mm,", "deepest", 5)),
        basis="omni-slide, metre reading: an arm that means to be 50 mm behind the wall slides {way:.3g} m; the device itself "
        "is up to {device:.3g} mm behind the surface",
    ),
    Statement(
        "6.5.2: simulated and measured penetration are of the same order", "the same order",
        (within("deepest device while it slides over its depth under 1 N", "order", 0.1, 10),),
        basis="the coupler of omni-slide: {pushed:.3g} mm under 1 N on material 1",
    ),
    Statement(
        "6.5.2: the trajectory of the end effector is an arc", "an arc; (6.8) takes x as a straight line",
        (below("arc over its rise along x, minus 1, at the deepest place", "arc", 0.05),),
        basis=f"{TIP_M:g} m from joint to tip; the rig emulates the straight line, whose error this is",
    ),
)
# fmt: on
