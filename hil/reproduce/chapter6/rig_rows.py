"""What the rig itself shows: the identification of Section 6.2.1, and the slide of Figures 6.9 and 6.10."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from design.controllers.rendered_wall import WallController
from design.controllers.wall import MATERIALS
from design.identification.axis import Record
from design.identification.output_error import identify_axis
from hil.compose.loop import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.measure.avatar import avatar_path, wall_loop_of
from hil.measure.view import APPLIED, MEASUREMENT, view_of
from hil.pages.html.figures import Figure, Series
from hil.reproduce.chapter import Plot
from hil.reproduce.statements import Statement, below, mean, says, within
from hil.session import simulate

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
