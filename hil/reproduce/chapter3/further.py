"""Section 3.4 beyond its example: gains of (3.41) itself, and what longer delays cost."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from design.as_printed.delayed_hinf import printed_section
from design.as_printed.examples import chapter3_gain, chapter3_process, chapter3_system
from design.semi_markov_loop.delayed_hinf import analyse_delayed
from hil.pages.html.figures import Figure, Series
from hil.reproduce.chapter import Plot, ReportProgress
from hil.reproduce.chapter3.partitions import BOUNDS, SECTIONS
from hil.reproduce.statements import Statement, above, exactly, says

Array = npt.NDArray[np.float64]
GAMMA = 0.93
DELAYS_S = (0.1, 0.2, 0.3, 0.6, 1.0, 1.5, 2.0)
SLOPES = (0.0, 0.3, 0.6, 0.9)


def further(report_progress: ReportProgress) -> dict[str, Any]:
    """Gains by (3.41) at the printed level, and certified levels of the printed gains over other delays."""
    system, process, printed = chapter3_system(), chapter3_process(), chapter3_gain()
    parts = [
        printed_section(system, process, SECTIONS, m, None, reading="consistent", gain_bound=BOUNDS[0], gamma=GAMMA)
        for m in (0, 1)
    ]
    found = np.array([_gains(part.matrices) for part in parts if part.certified]).swapaxes(0, 1)
    levels: dict[str, list[float]] = {"delays": [], "slopes": []}
    for n, delay_s in enumerate(DELAYS_S):
        report_progress(f"delays up to {delay_s:g} s", n, len(DELAYS_S) + len(SLOPES))
        levels["delays"].append(_gamma(analyse_delayed(replace(system, delay_max_s=delay_s), printed, process).gamma))
    for n, slope in enumerate(SLOPES):
        report_progress(f"slope {slope:g}", len(DELAYS_S) + n, len(DELAYS_S) + len(SLOPES))
        steady = replace(system, delay_slopes=np.full(system.modes, slope))
        levels["slopes"].append(_gamma(analyse_delayed(steady, printed, process).gamma))
    curve = Series(label="printed gains", x=np.array(DELAYS_S), y=np.array(levels["delays"]))
    figure = Figure(
        title="certified gamma", series=(curve,), x_label="largest delay", x_unit="s", y_label="gamma", sync=None
    )
    return levels | {
        "parts": parts, "first": "; ".join(" ".join(f"{v:.4f}" for v in row) for row in found[0, 0]),
        "off": float(np.abs(found - printed.gain).max()) if found.shape == printed.gain.shape else math.nan,
        "size": float(np.abs(printed.gain).max()),
        "rise": {name: float(np.diff(each).min()) for name, each in levels.items()},
        "figures": (Plot(title="Longer delays", panels=(figure,), intro="Corrected condition, slopes h_i as printed."),),
    }  # fmt: skip


def _gains(matrices: Mapping[str, Array]) -> list[Array]:
    return [matrices[f"U[{i}]"] @ np.linalg.inv(matrices[f"X[{i}]"]) for i in range(3)]


def _gamma(found: float | None) -> float:
    return math.nan if found is None else found


# fmt: off
FURTHER = (
    Statement(
        "3.4: the gains of Corollary 3.2 at gamma = 0.93", "K(i, m), six matrices",
        (
            *(says(f"(3.41), section {m + 1}, gains free", f"parts[{m}].verdict", "certified") for m in (0, 1)),
            exactly("largest difference of the gains", "off", 0, 0.5e-4, "size"),
        ),
        computed="K(1,1) = [{first}], largest difference {off:.3g}",
        basis=f"(3.41) with one rate in both places, gain norm <= {BOUNDS[0]:g}; half a unit of the last printed digit. An "
        "inequality alone, with no objective and no bound printed: the printed gains fulfil it too (above)",
    ),
    Statement(
        "(3.2): longer delays and delays that grow faster cost attenuation, printed gains", "-",
        (
            above(f"least rise of gamma, largest delays {DELAYS_S[0]:g} to {DELAYS_S[-1]:g} s", "rise[delays]", 0),
            above(f"least rise of gamma, slopes {SLOPES[0]:g} to {SLOPES[-1]:g}", "rise[slopes]", 0),
        ),
        computed="gamma {delays[0]:.3f} at 0.1 s, {delays[2]:.3f} at 0.3 s, {delays[6]:.3f} at 2 s; {slopes[0]:.3f} for delays "
        "that do not grow, {slopes[3]:.3f} for a slope of 0.9",
        basis="corrected condition; at other slopes the largest delay is 0.3 s",
    ),
)
# fmt: on
