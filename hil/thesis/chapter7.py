"""Chapter 7: the networked DC motor and the VTOL; every number of Section 7.4 beside what a correct computation gives.

Here too Figures 7.2 to 7.4 and 7.6 to 7.8: runs of the rig, with the predicted band, the fitted motor, and the Smith predictor.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from design.networked_loop.prediction import Prediction, predict_tracking
from hil.compose import compose
from hil.experiment import load_experiment
from hil.measure.batch_protocols import BatchView
from hil.measure.tracking import tracking_of_batch
from hil.pages import Band, Figure, Marker, Series
from hil.rig.loop import Loop
from hil.runtime.virtual import simulate
from hil.thesis import Chapter, Plot, ReportProgress, Stage
from hil.thesis.chapter7_delays import ESTIMATED, STAYS, TRADE_OFF, estimated_delay, stays, trade_off
from hil.thesis.chapter7_designs import DESIGNS, INFORMED, UNCERTAIN, designs, gain_bounds, information, uncertain
from hil.thesis.chapter7_friction import EXPERIMENT_ROWS, INTEGRAL, Imperfections, experiment, fit, integral_action, loop_of
from hil.thesis.chapter7_models import (
    LOCAL_DESIGNS,
    MODELS,
    NETWORK,
    VTOL_H2,
    VTOL_HINF,
    VTOL_LOCAL,
    everywhere,
    local_designs,
    models,
    vtol,
)
from hil.thesis.chapter7_runs import (
    CONTROLLERS,
    TABLE_7_1_ROWS,
    TABLE_7_2_ROWS,
    motor_prediction,
    motor_table,
    numbers_of,
    on_all_cores,
    vtol_table,
)
from hil.thesis.statements import Statement, above, below

Array = npt.NDArray[np.float64]
TOPICS = ("/plant/measurement", "/reference", "/actuator/applied")
SMITH_RUNS = 400
SMITH_GAINS = (-0.02, -0.03, -0.08, -0.16, -0.2)
SEED = 7


def ideal(controller: str, *sets: str) -> Loop:
    """The networked motor without imperfections at T = 0.05 s, with a published controller."""
    changes = (f"controller.kind={controller}", "allow_uncertified=true", *sets)
    return compose(load_experiment("dc-motor-hinf", changes), certify=False)


def angle(loop: Loop, seed: int) -> tuple[Array, Array]:
    """Time, s, and angle, rad, of one run."""
    run = simulate(loop, seed, TOPICS)
    measured = run.arrays["/plant/measurement"]
    return measured["slot"] * loop.model.period_s, np.asarray(measured["angle"], dtype=np.float64)


def _band(predicted: Prediction, target: float, period_s: float, where: str = "") -> Band:
    """Two standard deviations on either side of the predicted output."""
    mean, sd = predicted.error_mean[:, 0] + target, predicted.error_sd[:, 0]
    x = np.arange(len(mean)) * period_s
    return Band(label=f"predicted mean ± 2 sd{where}", x=x, lower=mean - 2 * sd, upper=mean + 2 * sd)


def motor_plots(motor: Imperfections, report_progress: ReportProgress) -> list[Plot]:
    """Figures 7.6 to 7.8: simulation, fitted motor, and what the recursion predicts."""
    plots = []
    figures = {"7.6": ("hinf", "H-infinity"), "7.7": ("h2", "H2"), "7.8": ("local", "local")}
    for number, (kind, name) in figures.items():
        report_progress(f"figure {number}")
        t, simulated = angle(ideal(kind), SEED)
        t_lab, lab = angle(loop_of(kind, motor), SEED)
        t_fast, fast = angle(ideal(kind, "period=25 ms"), SEED)
        series = [
            Series(label="simulation, T = 0.05 s", x=t, y=simulated, style="dashed"),
            Series(label="fitted motor, T = 0.05 s", x=t_lab, y=lab),
            Series(label="simulation, T = 0.025 s", x=t_fast, y=fast, style="dashed"),
        ]
        period_s = 0.025 if kind == "local" else 0.05
        predicted = motor_prediction(*CONTROLLERS[name], period_s)
        bands = (_band(predicted, 3.0, period_s, f", T = {period_s} s"),)
        note = "stopped by safety at T = 0.05 s: not mean-square stable" if kind == "local" else ""
        plots.append(
            Plot(
                title=f"Figure {number}: {name} controller",
                panels=(
                    Figure(
                        title="Motor angle", series=tuple(series), bands=bands, y_label="angle", y_unit="rad",
                        y_range=(-1.0, 7.0), markers=(Marker(x=30.0, label="disturbance"),), note=note,
                    ),
                ),
            )
        )  # fmt: skip
    return plots


def smith(report_progress: ReportProgress) -> dict[str, Any]:
    """Figure 7.4, and how the verdict on the Smith predictor depends on its gain."""
    loops = {"H-infinity (7.36)": ideal("hinf"), "H2 (7.37)": ideal("h2")}
    for gain in SMITH_GAINS:
        loops[f"Smith, {gain:g}"] = ideal("smith", f"controller.gain=[[{gain!r}]]")
    marks = _all_marks(loops, report_progress)
    shown = ("H-infinity (7.36)", "H2 (7.37)", "Smith, -0.03", "Smith, -0.16")
    series = tuple(
        Series(label=name, x=t, y=y, style="dashed" if name.startswith("Smith") else "line")
        for name in shown
        for t, y in [angle(loops[name], SEED)]
    )
    pulse = (Marker(x=30.0, label="disturbance"),)
    figure = Figure(title="Motor angle", series=series, y_label="angle", y_unit="rad", markers=pulse)
    ours, smiths = [[*marks.values()][part] for part in (slice(2), slice(2, None))]
    more = np.array([[[-_surely(each, other, k) for k in range(3)] for each in ours] for other in smiths])
    less = np.array([[[_surely(other, each, k) for k in range(3)] for each in ours] for other in smiths])
    holds = [bool((wins[:, ::2] > 0.0).all() and (loses[:, 1] < 0.0).all()) for wins, loses in zip(more, less, strict=True)]
    named = {"cautious": SMITH_GAINS.index(-0.03), "bold": SMITH_GAINS.index(-0.16)}
    return {
        "words": "; ".join(
            f"{name}: sse {m[0]:.2f}, overshoot {m[1]:.0f} %, peak {m[2]:.3f} rad"
            for name, m in ((name, m.mean(axis=0)) for name, m in marks.items())
        ),
        **{name: {"more": more[n], "less": less[n], "mean": smiths[n].mean(axis=0)} for name, n in named.items()},
        "holds": ", ".join(f"{gain:g}" for gain, each in zip(SMITH_GAINS, holds, strict=True) if each) or "none",
        "every": more.min(axis=(0, 1)), "hinf": {"mean": ours[0].mean(axis=0)},
        "figures": (Plot(title="Figure 7.4: Smith predictor", panels=(figure,)),),
    }  # fmt: skip


SMITH_BASIS = f"mean of {SMITH_RUNS} runs with the same delays, differences with 4 standard errors; the Smith gain is not printed"


# fmt: off
SMITH = (
    Statement(
        "Figure 7.4: the proposed controllers are faster than a Smith predictor, overshoot more, reject disturbances better",
        "holds",
        tuple(
            claim(f"{what} of Smith {gain}, less that of {which},", f"{name}[{side}][{n}][{k}]", 0)
            for gain, name in (("-0.03", "cautious"), ("-0.16", "bold"))
            for n, which in enumerate(("(7.36)", "(7.37)"))
            for claim, side, what, k in (
                (below, "less", "overshoot", 1), (above, "more", "sum of squares", 0),
                (above, "more", "disturbance peak, rad,", 2),
            )
        ),
        readings=True, computed="{words}", basis=f"{SMITH_BASIS}; of {SMITH_GAINS} it holds for {{holds}}",
    ),
    Statement(
        "the same for every Smith gain", "implied",
        (
            above("least sum of squares of a Smith predictor less that of (7.36) or (7.37)", "every[0]", 0),
            above("least disturbance peak of a Smith predictor less that of (7.36) or (7.37), rad,", "every[2]", 0),
        ),
        tuple(
            below(f"{what} of Smith -0.16 less that of (7.36)", f"bold[less][0][{k}]", 0)
            for k, what in enumerate(("sum of squares", "overshoot", "disturbance peak"))
        ),
        computed="gain -0.16: sse {bold[mean][0]:.2f} against {hinf[mean][0]:.2f}, peak {bold[mean][2]:.3f} against "
        "{hinf[mean][2]:.3f} rad of (7.36)",
        basis=f"{SMITH_BASIS}; a predictor with the exact model and a bolder gain is better in all three",
    ),
)
# fmt: on


def _surely(a: Array, b: Array, column: int) -> float:
    """Mean of a - b over the runs plus four standard errors: negative only if a is surely less than b."""
    less = a[:, column] - b[:, column]
    return float(less.mean() + 4.0 * less.std() / len(less) ** 0.5)


def _all_marks(loops: dict[str, Loop], report_progress: ReportProgress) -> dict[str, Array]:
    """Marks of every loop, (runs, 3) each: sum of squares, overshoot, and the largest error from the disturbance on, rad."""
    found = on_all_cores(_marks_of, [(loop,) for loop in loops.values()], report_progress, list(loops))
    return dict(zip(loops, found, strict=True))


def _marks_of(loop: Loop) -> Array:
    return numbers_of(loop, range(SMITH_RUNS), 3, _marks)


def _marks(view: BatchView) -> tuple[Array, Array, Array]:
    found = tracking_of_batch(view)
    peak = np.abs(view.outputs[0][:, view.t_s >= 30.0] - 3.0).max(axis=1)
    return found["sse"], found["overshoot"], peak


def vtol_plots(report_progress: ReportProgress) -> dict[str, Any]:
    """Figures 7.2 and 7.3: one run of the published controller, the predicted band, and the local gain that diverges."""
    plots = []
    plant = vtol()
    for number, kind, gains in (("7.2", "vtol-h2", VTOL_H2), ("7.3", "vtol-hinf", VTOL_HINF)):
        report_progress(f"figure {number}")
        loop = compose(load_experiment(kind), certify=False)
        run = simulate(loop, SEED, TOPICS)
        measured = run.arrays["/plant/measurement"]
        t = measured["slot"] * loop.model.period_s
        slots = len(t)
        reference, disturbance = np.ones(slots), np.zeros((slots, 2))
        disturbance[300] = 1.0
        predicted = predict_tracking(*plant, *NETWORK, gains, "generated", reference, period_s=0.01, disturbance=disturbance)
        local = predict_tracking(*plant, *NETWORK, everywhere(VTOL_LOCAL), "constant", reference[:60], period_s=0.01)
        panels = (
            Figure(
                title="Vertical velocity", y_label="velocity", y_unit="kn", sync="vtol",
                series=(Series(label="published gains, one run", x=t, y=measured["vertical_velocity"]),),
                bands=(_band(predicted, 1.0, loop.model.period_s),),
                markers=(Marker(x=3.0, label="impulse"),),
            ),
            Figure(
                title="Root mean square error", y_label="error", y_unit="kn", y_log=True, sync=None,
                series=(
                    Series(label="published gains", x=t, y=np.sqrt(predicted.square_mean)),
                    Series(label="local gain: diverges", x=t[:60], y=np.sqrt(local.square_mean)),
                ),
            ),
        )  # fmt: skip
        name = "H2" if kind == "vtol-h2" else "H-infinity"
        plots.append(Plot(title=f"Figure {number}: {name} controller of the VTOL", panels=panels))
    return {"figures": plots}


def _experiment(report_progress: ReportProgress) -> dict[str, Any]:
    """The experiment column of Table 7.2 with a fitted motor, and Figures 7.6 to 7.8."""
    motor, misfit = fit(report_progress)
    return experiment(motor, misfit, report_progress) | {"figures": motor_plots(motor, report_progress)}


CHAPTER = Chapter(
    title="Chapter 7: robust tracking control of a networked DC motor",
    stages=(
        Stage("models and statements", models, 1.5, MODELS),
        Stage("designs", designs, 45, DESIGNS),
        Stage("designs without the network", local_designs, 3, LOCAL_DESIGNS),
        Stage("Table 7.1", vtol_table, 8, TABLE_7_1_ROWS),
        Stage("Figures 7.2 and 7.3", vtol_plots, 1),
        Stage("Table 7.2, simulation", motor_table, 10, TABLE_7_2_ROWS),
        Stage("Smith predictor", smith, 3, SMITH),
        Stage("fit of the motor, Table 7.2, experiment", _experiment, 35, EXPERIMENT_ROWS),
        Stage("what the actuator knows", information, 25, INFORMED),
        Stage("an estimate of d", estimated_delay, 7, ESTIMATED),
        Stage("gain bounds", gain_bounds, 10),
        Stage("trade-off of the norms, lost packets", trade_off, 5, TRADE_OFF),
        Stage("uncertain plants", uncertain, 9, UNCERTAIN),
        Stage("integral action", integral_action, 2, INTEGRAL),
        Stage("the stay of d", stays, 0.5, STAYS),
    ),
)
