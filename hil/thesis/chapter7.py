"""Chapter 7: the networked DC motor and the VTOL; every number of Section 7.4 beside what a correct computation gives.

Here too Figures 7.2 to 7.4 and 7.6 to 7.8: runs of the rig, with the predicted band, the fitted motor, and the Smith predictor.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hil.errors import HilError
from hil.measure.batch_protocols import BatchView
from hil.measure.prediction import predict
from hil.measure.tracking import tracking_of_batch
from hil.pages import Band, Figure, Marker, Series
from hil.rig.loop import Loop
from hil.runtime.virtual import simulate
from hil.thesis import Array, Chapter, Plot, ReportProgress, Stage
from hil.thesis import chapter7_delays as delays
from hil.thesis import chapter7_designs as designs
from hil.thesis import chapter7_friction as friction
from hil.thesis import chapter7_models as models
from hil.thesis import chapter7_runs as runs
from hil.thesis.chapter7_runs import ideal, numbers_of, on_all_cores, upright
from hil.thesis.statements import above, below, statement

TOPICS = ("/plant/measurement", "/reference", "/actuator/applied")
SMITH_RUNS = 400
SMITH_GAINS = (-0.02, -0.03, -0.08, -0.16, -0.2)
SEED = 7


def angle(loop: Loop, seed: int) -> tuple[Array, Array]:
    """Time, s, and angle, rad, of one run."""
    run = simulate(loop, seed, TOPICS)
    measured = run.arrays["/plant/measurement"]
    return measured["slot"] * loop.model.period_s, np.asarray(measured["angle"], dtype=np.float64)


def _predicted(loop: Loop) -> tuple[Array, Array]:
    """Mean and deviation of the tracking error in every slot."""
    found = predict(loop, loop.experiment.slots)
    if found is None:
        raise HilError(f"{loop.experiment.name}: nothing is predicted")
    return found.error_mean[:, 0], found.error_sd[:, 0]


def _band(loop: Loop, predicted: tuple[Array, Array], where: str = "") -> Band:
    """Two standard deviations on either side of the predicted output."""
    (error, sd), reference = predicted, loop.reference().at
    mean = error + [reference(k)[0] for k in range(len(error))]
    x = np.arange(len(error)) * loop.model.period_s
    return Band(label=f"predicted mean ± 2 sd{where}", x=x, lower=mean - 2 * sd, upper=mean + 2 * sd)


def motor_plots(motor: friction.Imperfections, report_progress: ReportProgress) -> list[Plot]:
    """Figures 7.6 to 7.8: simulation, fitted motor, and what the recursion predicts."""
    plots = []
    for number, (name, kind) in zip(("7.6", "7.7", "7.8"), runs.KINDS.items(), strict=True):
        report_progress(f"figure {number}")
        stated, fast = ideal(kind), ideal(kind, "period=25 ms")
        drawn = {
            "simulation, T = 0.05 s": stated, "fitted motor, T = 0.05 s": friction.loop_of(kind, motor),
            "simulation, T = 0.025 s": fast,
        }  # fmt: skip
        series = [
            Series(label=label, x=t, y=y, style="dashed" if label.startswith("simulation") else "line")
            for label, loop in drawn.items()
            for t, y in [angle(loop, SEED)]
        ]
        shown = fast if kind == "local" else stated
        note = "stopped by safety at T = 0.05 s: not mean-square stable" if kind == "local" else ""
        panel = Figure(
            title="Motor angle", series=tuple(series), y_label="angle", y_unit="rad", y_range=(-1.0, 7.0), note=note,
            bands=(_band(shown, _predicted(shown), f", T = {shown.model.period_s} s"),),
            markers=(Marker(x=30.0, label="disturbance"),),
        )  # fmt: skip
        plots.append(Plot(title=f"Figure {number}: {name} controller", panels=(panel,)))
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
    apart = np.array([[other - each for each in ours] for other in smiths])  # (gains, ours, runs, marks)
    mean, errors = apart.mean(axis=2), 4.0 * apart.std(axis=2) / SMITH_RUNS**0.5
    more, less = mean - errors, mean + errors
    holds = (more[:, :, ::2] > 0.0).all(axis=(1, 2)) & (less[:, :, 1] < 0.0).all(axis=1)
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
    statement(
        "Figure 7.4: the proposed controllers are faster than a Smith predictor, overshoot more, reject disturbances better",
        "holds",
        *(
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
    statement(
        "the same for every Smith gain", "implied",
        above("least sum of squares of a Smith predictor less that of (7.36) or (7.37)", "every[0]", 0),
        above("least disturbance peak of a Smith predictor less that of (7.36) or (7.37), rad,", "every[2]", 0),
        witness=tuple(
            below(f"{what} of Smith -0.16 less that of (7.36)", f"bold[less][0][{k}]", 0)
            for k, what in enumerate(("sum of squares", "overshoot", "disturbance peak"))
        ),
        computed="gain -0.16: sse {bold[mean][0]:.2f} against {hinf[mean][0]:.2f}, peak {bold[mean][2]:.3f} against "
        "{hinf[mean][2]:.3f} rad of (7.36)",
        basis=f"{SMITH_BASIS}; a predictor with the exact model and a bolder gain is better in all three",
    ),
)
# fmt: on


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
    plots, local = [], upright("local H2", "duration=0.6 s")
    diverging = _rms("local gain: diverges", local, _predicted(local))
    for number, name in (("7.2", "H2"), ("7.3", "H-infinity")):
        report_progress(f"figure {number}")
        predicted = _predicted(loop := upright(name))
        run = simulate(loop, SEED, TOPICS)
        measured = run.arrays["/plant/measurement"]
        panels = (
            Figure(
                title="Vertical velocity", y_label="velocity", y_unit="kn", sync="vtol",
                series=(
                    Series(
                        label="published gains, one run", x=measured["slot"] * loop.model.period_s,
                        y=measured["vertical_velocity"],
                    ),
                ),
                bands=(_band(loop, predicted),), markers=(Marker(x=3.0, label="impulse"),),
            ),
            Figure(
                title="Root mean square error", y_label="error", y_unit="kn", y_log=True, sync=None,
                series=(_rms("published gains", loop, predicted), diverging),
            ),
        )  # fmt: skip
        plots.append(Plot(title=f"Figure {number}: {name} controller of the VTOL", panels=panels))
    return {"figures": plots}


def _rms(label: str, loop: Loop, predicted: tuple[Array, Array]) -> Series:
    rms = np.hypot(*predicted)
    return Series(label=label, x=np.arange(len(rms)) * loop.model.period_s, y=rms)


def _experiment(report_progress: ReportProgress) -> dict[str, Any]:
    """The experiment column of Table 7.2 with a fitted motor, and Figures 7.6 to 7.8."""
    motor, misfit = friction.fit(report_progress)
    return friction.experiment(motor, misfit, report_progress) | {"figures": motor_plots(motor, report_progress)}


CHAPTER = Chapter(
    title="Chapter 7: robust tracking control of a networked DC motor",
    stages=(
        Stage("models and statements", models.models, 1.5, models.MODELS),
        Stage("designs", designs.designs, 45, designs.DESIGNS),
        Stage("designs without the network", models.local_designs, 3, models.LOCAL_DESIGNS),
        Stage("Table 7.1", runs.vtol_table, 8, runs.TABLE_7_1_ROWS),
        Stage("Figures 7.2 and 7.3", vtol_plots, 1),
        Stage("Table 7.2, simulation", runs.motor_table, 10, runs.TABLE_7_2_ROWS),
        Stage("Smith predictor", smith, 3, SMITH),
        Stage("fit of the motor, Table 7.2, experiment", _experiment, 35, friction.EXPERIMENT_ROWS),
        Stage("what the actuator knows", designs.information, 25, designs.INFORMED),
        Stage("an estimate of d", delays.estimated_delay, 7, delays.ESTIMATED),
        Stage("gain bounds", designs.gain_bounds, 10),
        Stage("trade-off of the norms, lost packets", delays.trade_off, 5, delays.TRADE_OFF),
        Stage("uncertain plants", designs.uncertain, 9, designs.UNCERTAIN),
        Stage("integral action", friction.integral_action, 2, friction.INTEGRAL),
        Stage("the stay of d", delays.stays, 0.5, delays.STAYS),
    ),
)
