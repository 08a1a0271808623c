"""Chapter 6: Theorem 6.1, transparency, and what the rig shows: the identification, Figures 6.8 to 6.10."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from design.as_printed.chapters_5_and_6 import (
    DELAY,
    LAMBDA,
    PERIOD_S,
    energy_of_a_press,
    least_real_part,
    meets_printed_condition,
    printed_distortion,
    theorem_61_coupler,
)
from design.controllers.rendered_wall import Coupler, WallController, static_coupler
from design.controllers.wall import MATERIALS
from design.identification import Record
from design.identification.output_error import identify_axis
from design.jump_linear.bounded_real import hinf_norm
from design.passivity import HapticLoop, HeldDevice, push_response
from design.passivity.transparency import distortion_bound
from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.measure.view import APPLIED, MEASUREMENT, view_of
from hil.pages import Figure, Series
from hil.runtime.virtual import simulate
from hil.session.replay.avatar import avatar_path, wall_loop_of
from hil.thesis import Chapter, Plot, Stage, chapter6_equations, chapter6_wall
from hil.thesis.chapter6_equations import DEVICE, READINGS, TIP_M, WAVE, B, bare_n_s_per_m, distortion_norm, loop_of, safe_coupler
from hil.thesis.statements import above, below, exactly, mean, says, statement, within


def identification() -> dict[str, Any]:
    """Return the numbers of (6.2)."""
    experiment = load_experiment("omni-identify", [])
    run = simulate(compose(experiment), experiment.seed)
    record = Record(u=run.arrays[APPLIED]["torque"], y=run.arrays[MEASUREMENT]["angle"], period_s=float(experiment.period))
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
    statement(
        "(6.2): m and b from a square wave of 0.4545 Hz and 0.02", "0.7943, 1.9857",
        mean("m", "fit.inertia.value", "0.7943", error="fit.inertia.error", why="of the fit"),
        mean("b", "fit.damping.value", "1.9857", error="fit.damping.error", why="of the fit"),
        says("residuals", "fit.residuals.verdict", "white"),
        basis="the emulated joint has these numbers: what is reproduced is that the printed experiment finds them, with "
        "noise of 1e-3 on the encoder, by output error. Plain least squares: {plain}",
    ),
)
SLIDE = (
    statement(
        "Figure 6.9: the avatar's displacement along x is very small", "very small",
        below("deepest avatar over the length of its way", "share", 0.001), below("deepest avatar, mm,", "deepest", 5),
        basis="omni-slide, metre reading: an arm that means to be 50 mm behind the wall slides {way:.3g} m; the device itself "
        "is up to {device:.3g} mm behind the surface",
    ),
    statement(
        "6.5.2: simulated and measured penetration are of the same order", "the same order",
        within("deepest device while it slides over its depth under 1 N", "order", 0.1, 10),
        basis="the coupler of omni-slide: {pushed:.3g} mm under 1 N on material 1",
    ),
    statement(
        "6.5.2: the trajectory of the end effector is an arc", "an arc; (6.8) takes x as a straight line",
        below("arc over its rise along x, minus 1, at the deepest place", "arc", 0.05),
        basis=f"{TIP_M:g} m from joint to tip; the rig emulates the straight line, whose error this is",
    ),
)
# fmt: on

SLOTS = 800
CUTOFF_HZ = 3.0


def passivity(device: HeldDevice = DEVICE) -> dict[str, Any]:
    """Return the numbers of Section 6.3."""
    b = device.damping_n_s_per_m
    printed = theorem_61_coupler(b)
    loop = loop_of(printed, device)
    return {
        "b": b, "bare": [bare_n_s_per_m(materials) for materials in READINGS.values()],
        "B": [min(m.damping_n_s_per_m for m in materials) for materials in READINGS.values()],
        "radius": [max(loop.radius(m, n, 0) for m in MATERIALS) for n in (0, 1, DELAY)],
        "meets": "meets (6.9)" if meets_printed_condition(printed, b) else "misses (6.9)",
        "moments": loop.jump_system(MATERIALS, LAMBDA, DELAY, 0).radius(),
        "real": [least_real_part(device, n) for n in (0, DELAY)], "twice": least_real_part(device, 0, twice=True),
        "press": [energy_of_a_press(r) for r in ("plain", "energy")],
    }  # fmt: skip


def transparency() -> dict[str, Any]:
    """Return the numbers of Section 6.4."""
    creep = loop_of(Coupler(taps_m_per_n=WAVE.taps_m_per_n, integrator_m_per_n=0.0025))
    depth = push_response(creep, MATERIALS[0], DELAY, 0, 1.0, 4000)
    return {
        "meant": distortion_norm(WAVE, CUTOFF_HZ),
        "printed": hinf_norm(printed_distortion(MATERIALS, LAMBDA, WAVE, cutoff_hz=CUTOFF_HZ)),
        "off": MATERIALS[0].stiffness_n_per_m, "best": distortion_norm(WAVE, CUTOFF_HZ, mixed=False),
        "without": distortion_norm(static_coupler(0.0), CUTOFF_HZ, mixed=False),
        "bound": distortion_bound(MATERIALS[0], period_s=PERIOD_S, delay=DELAY, cutoff_hz=CUTOFF_HZ),
        "drift": float(depth[4000] - depth[2000]),
    }  # fmt: skip


def push() -> dict[str, Any]:
    """Return the numbers and the picture of Section 6.5.1."""
    safe = loop_of(safe_coupler())
    responses = [push_response(safe, m, DELAY, 0, 1.0, SLOTS) for m in MATERIALS]
    final, peak = [float(x[-1]) for x in responses], [float(x.max()) for x in responses]
    return {
        "apart": 1e3 * abs(final[1] - final[2]), "final": 1e3 * final[1], "deeper": 1e3 * (final[1] - final[0]),
        "overshoot": 1e3 * min(p - x for p, x in zip(peak, final)), "start": 1e3 * float(responses[0][1]),
        "rest": 1e3 * max(float(np.abs(x[-100:] - x[-1]).max()) for x in responses), "figures": (push_plot(safe),),
    }  # fmt: skip


def push_plot(safe: HapticLoop) -> Plot:
    """Return Figure 6.8: the three materials with the safe coupler, and the printed one beside."""
    t = np.arange(SLOTS // 2 + 1) * PERIOD_S
    curves = tuple(
        Series(label=f"material {i + 1}", x=t, y=1e3 * push_response(safe, m, DELAY, 0, 1.0, SLOTS // 2))
        for i, m in enumerate(MATERIALS)
    )
    lossless = push_response(loop_of(WAVE), MATERIALS[0], DELAY, 0, 1.0, SLOTS // 2)
    printed = push_response(loop_of(theorem_61_coupler(B)), MATERIALS[0], DELAY, 0, 1.0, 50)
    panels = (
        Figure(title="6.8: penetration under 1 N, delays 0 to 8 safe", series=curves, y_label="depth", y_unit="mm"),
        Figure(
            title="the same with other couplers, material 1", y_label="depth", y_unit="mm",
            series=(
                Series(label="wave coupler for six samples", x=t, y=1e3 * lossless),
                Series(label="T/(2 b) of Theorem 6.1", x=t[:51], y=1e3 * printed, style="dashed"),
            ),
        ),
    )  # fmt: skip
    return Plot(title="Figure 6.8", panels=panels)


# fmt: off
PASSIVITY = (
    statement(
        "6.3: without a coupler b > K T/2 + |B| cannot be guaranteed", "not b > K T/2 + |B|",
        *(
            above(f"least {what}, {reading},", f"{name}[{n}]", "b")
            for n, reading in enumerate(READINGS)
            for what, name in (("K T/2 + |B| of the materials", "bare"), ("|B|, which remains as T -> 0", "B"))
        ),
        readings=True,
        basis="b = {b:g}: at the tip it fails for every material at every period, so that a coupler is needed; at the joint it "
        "holds. The units of (6.1) and (6.2) contradict each other",
    ),
    statement(
        "Theorem 6.1: (6.9) makes the networked system oscillation free", "for every passive hand, over the delays",
        below("spectral radius at six samples", "radius[2]", 1),
        witness=(
            says("T/(2 b)", "meets", "meets (6.9)"), below("radius without delay", "radius[0]", 1),
            above("radius at one sample", "radius[1]", 1),
        ),
        basis="no hand, which is passive; the worst material",
    ),
    statement(
        "Remark 6.3: passivity establishes stochastic stability", "mean-square stable",
        below("second-moment radius under Lambda", "moments", 1), witness=(above("that radius", "moments", 1),),
        basis="the coupler T/(2 b) at six samples of delay",
    ),
    statement(
        "(6.10) is positive real", "for every delay", above("least real part at six samples", "real[1]", 0),
        witness=(above("least real part without delay", "real[0]", 0), below("at six samples", "real[1]", 0)),
        basis="z^-n times a positive real function is not positive real",
    ),
    statement(
        "(6.10) without delay, F(z) as printed, with 1/s^2 M(s)", "positive real", above("least real part", "twice", 0),
        witness=(below("least real part", "twice", 0), above("the same with 1/s M(s)", "real[0]", 0)),
        basis="M(s) of (6.1) is a position already: F integrates once too often",
    ),
    statement(
        "(6.11): the switching wall is passive", "v f >= change of V_E",
        above("energy that a press at 800 and a release at 1000 N/m absorbs, J,", "press[0]", -1e-9),
        witness=(below("that energy", "press[0]", 0), above("with the energy rule", "press[1]", -1e-9)),
        basis="V_E has no mode in it; 0.1 m deep",
    ),
)
TRANSPARENCY = (
    statement(
        "(6.14), the subject of (6.17): the system of Figure 6.6, weighted by (6.13)", "F",
        exactly("norm of (6.14) as printed beside that of Figure 6.6, N/m,", "printed", "meant", 1e-6),
        witness=(below("norm of (6.14)", "printed", 1e-9), above("of Figure 6.6", "meant", 100)),
        basis=f"B_w is missing from the last rows, so that nothing drives W; wave coupler, weight of {CUTOFF_HZ:g} Hz, Lambda",
    ),
    statement(
        "(6.12): the smallest distortion is the most transparent wall", "-",
        below(f"distortion of the stiffest safe coupler under a weight of {CUTOFF_HZ:g} Hz, N/m,", "best", "off"),
        witness=(
            above("distortion of that coupler", "best", "off"), above("without a coupler", "without", "off"),
            below("at least, for any causal rendering,", "bound", "off"),
        ),
        basis="material 1; no wall at all has {off:g} N/m: it is nearer to the target, which has no delay",
    ),
    statement(
        "6.4: C = C_bar + d z/(z - 1) + D_c, with a constant depth", "constant depth (Figure 6.8)",
        below("creep of the avatar in 100 s under 1 N with d = 0.0025, m,", "drift", 0.01),
        witness=(above("that creep", "drift", 1),), basis="an integrator lets the static stiffness vanish: d must be 0",
    ),
)
PUSH = (
    statement(
        "Figure 6.8: materials 2 and 3 end at one depth", "the same",
        exactly("difference of the final depths, mm,", "apart", 0, 1e-3, "final"),
        exactly("deeper than material 1, mm,", "deeper", 0.25, 1e-3),
        basis="1 N on the free device; the stiffest coupler for 0 to 8 samples of delay, as no coupler is printed",
    ),
    statement(
        "Figure 6.8: decaying oscillation, then a constant depth", "yes",
        above("least overshoot, mm,", "overshoot", 1), below("movement in the last 5 s, mm,", "rest", 0.1), basis="the same",
    ),
    statement(
        "Figure 6.8: the delays of the responses are caused by the network", "the response begins late",
        below("movement after one sample, mm,", "start", 1e-9), witness=(above("movement after one sample, mm,", "start", 0.1),),
        basis="the push acts on the device itself; only its image arrives late",
    ),
)
CHAPTER = Chapter(
    title="Chapter 6: a haptic example",
    stages=(
        Stage("identification", lambda report: identification(), 1, IDENTIFICATION),
        Stage("equations", lambda report: chapter6_equations.equations(), 1, chapter6_equations.EQUATIONS),
        Stage("statements", lambda report: chapter6_equations.statements(), 1, chapter6_equations.STATEMENTS),
        Stage("mixed wall", lambda report: chapter6_wall.wall(), 2, chapter6_wall.WALL),
        Stage("passivity", lambda report: passivity(), 1, PASSIVITY),
        Stage("transparency", lambda report: transparency(), 1, TRANSPARENCY),
        Stage("materials", lambda report: chapter6_wall.materials(), 2, (*chapter6_wall.OWN, *chapter6_wall.LATER)),
        Stage("push", lambda report: push(), 1, PUSH),
        Stage("slide", lambda report: slide(), 1, SLIDE),
    ),
)
# fmt: on
