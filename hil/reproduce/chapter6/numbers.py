"""Chapter 6: every statement that can be computed, beside what comes out."""

from __future__ import annotations

import numpy as np

from design.as_printed.coupler import (
    DELAY,
    LAMBDA,
    PERIOD_S,
    energy_of_a_press,
    least_real_part,
    meets_printed_condition,
    printed_distortion,
    theorem_61_coupler,
)
from design.controllers.coupler import Coupler, static_coupler, wave_coupler
from design.controllers.wall import MATERIALS
from design.jump_linear.bounded_real import hinf_norm
from design.passivity.device import HeldDevice
from design.passivity.loop import HapticLoop, push_response
from design.passivity.synthesis import stiffest_coupler
from design.passivity.transparency import distortion, distortion_bound
from hil.report.html.figures import Figure, Series
from hil.reproduce.chapter import Chapter, Part, Plot, ReportProgress, Stage
from hil.reproduce.chapter6.equation_rows import equation_rows
from hil.reproduce.chapter6.rig_rows import identification_rows, slide_part
from hil.reproduce.chapter6.statement_rows import statement_rows
from hil.reproduce.chapter6.wall_rows import wall_rows
from hil.reproduce.judgement import Row, above, below, near, row, says, within
from plants.omni import Omni

SLOTS = 800


def published_device() -> HeldDevice:
    """Return the device of (6.2) without a hand."""
    omni = Omni()
    return HeldDevice(mass_kg=omni.inertia, damping_n_s_per_m=omni.damping)


def _identification(report_progress: ReportProgress) -> Part:
    return Part(rows=tuple(identification_rows()))


def _equations(report_progress: ReportProgress) -> Part:
    return Part(rows=tuple(equation_rows(published_device())))


def _statements(report_progress: ReportProgress) -> Part:
    return Part(rows=tuple(statement_rows(published_device())))


def _slide(report_progress: ReportProgress) -> Part:
    return slide_part()


def _mixed_wall(report_progress: ReportProgress) -> Part:
    return Part(rows=tuple(wall_rows()))


def _passivity(report_progress: ReportProgress) -> Part:
    return Part(rows=tuple(passivity_rows(published_device())))


def _transparency(report_progress: ReportProgress) -> Part:
    return Part(rows=tuple(transparency_rows(published_device())))


def _push(report_progress: ReportProgress) -> Part:
    device = published_device()
    safe = stiffest_coupler(range(9), period_s=PERIOD_S, damping_n_s_per_m=device.damping_n_s_per_m).coupler
    return Part(rows=tuple(push_rows(device, safe)), figures=(push_plot(device, safe),))


def loop_of(device: HeldDevice, coupler: Coupler) -> HapticLoop:
    """Return the published loop, three samples of delay on each side, with a coupler."""
    return HapticLoop(device=device, coupler=coupler, period_s=PERIOD_S, sc_max=DELAY, ca_max=0)


def passivity_rows(device: HeldDevice) -> list[Row]:
    """Return the rows of Section 6.3."""
    b = device.damping_n_s_per_m
    needed = [m.stiffness_n_per_m * PERIOD_S / 2 + m.damping_n_s_per_m for m in MATERIALS]
    printed = theorem_61_coupler(b)
    loop = loop_of(device, printed)
    radii = {n: max(loop.radius(m, n, 0) for m in MATERIALS) for n in (0, 1, DELAY)}
    real = {n: least_real_part(device, n) for n in (0, DELAY)}
    press = {rule: energy_of_a_press(rule) for rule in ("plain", "energy")}
    moments = loop.jump_system(MATERIALS, LAMBDA, DELAY, 0).radius()
    meets = "meets (6.9)" if meets_printed_condition(printed, b) else "misses (6.9)"
    return [
        row(
            "6.3: without a coupler b > K T/2 + |B| cannot be guaranteed", f"b = {b:g} N s/m",
            above("least K T/2 + |B| of the materials, N s/m,", min(needed), b),
            above("least |B|, which remains as T -> 0,", min(m.damping_n_s_per_m for m in MATERIALS), b),
            basis="metre reading: it fails for every material at every period, so that a coupler is needed",
        ),
        row(
            "Theorem 6.1: (6.9) makes the networked system oscillation free", "for every passive hand, over the delays",
            below("spectral radius at six samples", radii[DELAY], 1.0),
            witness=(
                says("T/(2 b)", meets, "meets (6.9)"), below("radius without delay", radii[0], 1.0),
                above("radius at one sample", radii[1], 1.0),
            ),
            basis="no hand, which is passive; the worst material",
        ),
        row(
            "Remark 6.3: passivity establishes stochastic stability", "mean-square stable",
            below("second-moment radius under Lambda", moments, 1.0), witness=(above("that radius", moments, 1.0),),
            basis="the coupler T/(2 b) at six samples of delay",
        ),
        row(
            "(6.10) is positive real", "for every delay", above("least real part at six samples", real[DELAY], 0.0),
            witness=(above("least real part without delay", real[0], 0.0), below("at six samples", real[DELAY], 0.0)),
            basis="z^-n times a positive real function is not positive real",
        ),
        row(
            "(6.11): the switching wall is passive", "v f >= change of V_E",
            above("energy that a press at 800 and a release at 1000 N/m absorbs, J,", press["plain"], -1e-9),
            witness=(below("that energy", press["plain"], 0.0), above("with the energy rule", press["energy"], -1e-9)),
            basis="V_E has no mode in it; 0.1 m deep",
        ),
    ]  # fmt: skip


def transparency_rows(device: HeldDevice) -> list[Row]:
    """Return the rows of Section 6.4."""
    wave, cutoff = wave_coupler(PERIOD_S, device.damping_n_s_per_m, DELAY), 3.0

    def norm(coupler: Coupler) -> float:
        return hinf_norm(distortion(MATERIALS[:1], [[1.0]], coupler, period_s=PERIOD_S, delay=DELAY, cutoff_hz=cutoff))

    meant = hinf_norm(distortion(MATERIALS, LAMBDA, wave, period_s=PERIOD_S, delay=DELAY, cutoff_hz=cutoff))
    printed = hinf_norm(printed_distortion(MATERIALS, LAMBDA, wave, cutoff_hz=cutoff))
    wall_off = MATERIALS[0].stiffness_n_per_m
    best = norm(wave)
    bound = distortion_bound(MATERIALS[0], period_s=PERIOD_S, delay=DELAY, cutoff_hz=cutoff)
    creep = loop_of(device, Coupler(taps_m_per_n=wave.taps_m_per_n, integrator_m_per_n=0.0025))
    depth = push_response(creep, MATERIALS[0], DELAY, 0, 1.0, 4000)
    drift = float(depth[4000] - depth[2000])
    return [
        row(
            "(6.14), of which (6.17) speaks: the system of Figure 6.6, weighted by (6.13)", "F",
            near("norm of (6.14) as printed beside that of Figure 6.6, N/m,", printed, meant, relative=0.01),
            witness=(below("norm of (6.14)", printed, 1e-9), above("of Figure 6.6", meant, 100.0)),
            basis=f"B_w is missing from the last rows, so that nothing drives W; wave coupler, weight of {cutoff:g} Hz, Lambda",
        ),
        row(
            "(6.12): the smallest distortion is the most transparent wall", "-",
            below(f"distortion of the stiffest safe coupler under a weight of {cutoff:g} Hz, N/m,", best, wall_off),
            witness=(
                above("distortion of that coupler", best, wall_off),
                above("without a coupler", norm(static_coupler(0.0)), wall_off),
                below("at least, for any causal rendering,", bound, wall_off),
            ),
            basis=f"material 1; no wall at all has {wall_off:g} N/m: it is nearer to the target, which has no delay",
        ),
        row(
            "6.4: C = C_bar + d z/(z - 1) + D_c, with a constant depth", "constant depth (Figure 6.8)",
            below("creep of the avatar in 100 s under 1 N with d = 0.0025, m,", drift, 0.01),
            witness=(above("that creep", drift, 1.0),), basis="an integrator lets the static stiffness vanish: d must be 0",
        ),
    ]  # fmt: skip


def push_rows(device: HeldDevice, safe: Coupler) -> list[Row]:
    """Return the rows of Section 6.5.1."""
    responses = [push_response(loop_of(device, safe), m, DELAY, 0, 1.0, SLOTS) for m in MATERIALS]
    final, peak = [float(x[-1]) for x in responses], [float(x.max()) for x in responses]
    rest = max(float(np.abs(x[-100:] - x[-1]).max()) for x in responses)
    start = float(responses[0][1])
    return [
        row(
            "Figure 6.8: materials 2 and 3 end at one depth", "the same",
            below("difference of the final depths, mm,", 1e3 * abs(final[1] - final[2]), 1e-3),
            within("deeper than material 1, mm,", 1e3 * (final[1] - final[0]), 0.249, 0.251),
            basis="1 N on the free device; the stiffest coupler for 0 to 8 samples of delay, as no coupler is printed",
        ),
        row(
            "Figure 6.8: decaying oscillation, then a constant depth", "yes",
            above("least overshoot, mm,", 1e3 * min(p - x for p, x in zip(peak, final)), 1.0),
            below("movement in the last 5 s, mm,", 1e3 * rest, 0.1), basis="the same",
        ),
        row(
            "Figure 6.8: the delays of the responses are caused by the network", "the response begins late",
            below("movement after one sample, mm,", 1e3 * start, 1e-9),
            witness=(above("movement after one sample, mm,", 1e3 * start, 0.1),),
            basis="the push acts on the device itself; only its image arrives late",
        ),
    ]  # fmt: skip


def push_plot(device: HeldDevice, safe: Coupler) -> Plot:
    """Return Figure 6.8: the three materials with the safe coupler, and the printed one beside."""
    t = np.arange(SLOTS // 2 + 1) * PERIOD_S
    curves = tuple(
        Series(label=f"material {i + 1}", x=t, y=1e3 * push_response(loop_of(device, safe), m, DELAY, 0, 1.0, SLOTS // 2))
        for i, m in enumerate(MATERIALS)
    )
    wave = wave_coupler(PERIOD_S, device.damping_n_s_per_m, DELAY)
    lossless = push_response(loop_of(device, wave), MATERIALS[0], DELAY, 0, 1.0, SLOTS // 2)
    printed = push_response(loop_of(device, theorem_61_coupler(device.damping_n_s_per_m)), MATERIALS[0], DELAY, 0, 1.0, 50)
    panels = (
        Figure(title="6.8: penetration under 1 N, delays 0 to 8 safe", series=curves, y_label="depth", y_unit="mm"),
        Figure(
            title="the same with other couplers, material 1",
            series=(
                Series(label="wave coupler for six samples", x=t, y=1e3 * lossless),
                Series(label="T/(2 b) of Theorem 6.1", x=t[:51], y=1e3 * printed, style="dashed"),
            ),
            y_label="depth",
            y_unit="mm",
        ),
    )
    return Plot(title="Figure 6.8", panels=panels)


CHAPTER = Chapter(
    title="Chapter 6: a haptic example",
    stages=(
        Stage("identification", _identification),
        Stage("equations", _equations),
        Stage("statements", _statements),
        Stage("mixed wall", _mixed_wall, 2),
        Stage("passivity", _passivity),
        Stage("transparency", _transparency),
        Stage("push", _push),
        Stage("slide", _slide),
    ),
)
