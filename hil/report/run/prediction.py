"""Theory and emulation on one picture: the predicted tracking error, the run, and many more runs of the same experiment."""

from __future__ import annotations

from typing import Any

import numpy as np

from design.controllers import GainTable, integrates
from hil.compose.delay_chains import delay_chains, gains_over, initial_laws
from hil.compose.loop import Loop, compose
from hil.errors import HilError
from hil.measure.signals import with_unit
from hil.measure.step_response import target_of
from hil.measure.tracking import squared_unit
from hil.measure.view import MEASUREMENT, REFERENCE, RunView, matrix
from hil.report.html.figures import Band, Block, Figure, Section, Series, Table
from hil.session import simulate
from hil.sweeps.lockstep import in_lockstep, run_together

RUNS = 100
TICKS = 120_000  # of emulation that a page may cost: some 3 s
FEWEST = 20
MOST_SLOTS = 100_000
"""Slots that are predicted at most: the first ones of a longer run."""


def theory_section(view: RunView) -> Section | None:
    """Return the panels of predicted mean and spread, with the run and a Monte Carlo band over them.

    None where there is no prediction: a controller that is no table of gains, a network law without a chain, a reference that
    no input holds, faults on the time line, or a log whose experiment cannot be made again here.
    """
    if view.experiment is None or view.experiment.fault:
        return None
    try:
        loop = compose(view.experiment, certify=False)
    except HilError:
        return None
    chains = delay_chains(loop.experiment)
    if not isinstance(loop.controller, GainTable) or None in chains:
        return None
    names = list(view.signals.outputs)
    slots = min(len(view.run.arrays[topic]) for topic in (MEASUREMENT, REFERENCE))
    ticks = min(slots, MOST_SLOTS)
    y, r = (matrix(view.run.arrays[topic][:ticks], names) for topic in (MEASUREMENT, REFERENCE))
    if ticks < 2:
        return None
    predicted = _predict(loop, loop.controller, chains, r[:ticks])
    if predicted is None:
        return None
    many = _emulate(loop, names, ticks)
    t = np.arange(ticks) * loop.model.period_s
    blocks: list[Block] = []
    for c, name in enumerate(names):
        mean, sd = predicted.error_mean[:ticks, c], predicted.error_sd[:ticks, c]
        bands = [Band(label="predicted mean +- 2 sd", x=t, lower=mean - 2 * sd, upper=mean + 2 * sd, colour=2)]
        if many is not None:
            low, high = np.percentile(many[:, :, c], (2.5, 97.5), axis=0)
            bands.append(Band(label=f"95 % of {len(many)} more runs", x=t, lower=low, upper=high, colour=0))
        blocks.append(
            Figure(
                title=f"Tracking error of {name.replace('_', ' ')}",
                series=(
                    Series(label="predicted mean", x=t, y=mean, style="dashed", colour=2),
                    Series(label="this run", x=t, y=y[:ticks, c] - r[:ticks, c], colour=1),
                ),
                bands=tuple(bands),
                y_label="error",
                y_unit=view.signals.outputs[name],
                height_px=280,
            )
        )
    squared = squared_unit(view.signals)
    part = "" if ticks == slots else f" Both are of the first {ticks} slots of {slots}."
    sums: list[list[Any]] = []
    rows = zip(("whole run", "from 5 s on"), predicted.sum_mean, predicted.sum_sd, _starts(loop, ticks))
    for label, mean_sum, sd_sum, start in rows:
        error = y[start:ticks] - target_of(r)[start:ticks]
        sums.append([label, float(mean_sum), float(sd_sum), float((error**2).sum() * loop.model.period_s)])
    blocks.append(
        Table(
            columns=(with_unit("squared tracking error", squared), "predicted mean", "predicted sd", "this run"),
            rows=sums,
            note="Squared error against the value stepped to, summed over the samples, times T, as in Table 7.2.",
        )
    )
    return Section(
        title="Theory and emulation",
        blocks=tuple(blocks),
        intro=(
            "The covariance recursion of the jump-linear loop predicts the error, with transients, from the nominal linear "
            "model, the gains and the chains. A run of this model seldom leaves the band." + part
        ),
    )


def _starts(loop: Loop, ticks: int) -> tuple[int, ...]:
    after = round(5.0 / loop.model.period_s)
    return (0, after) if after < ticks else (0,)


def _predict(loop: Loop, controller: GainTable, chains: tuple[Any, Any], r: np.ndarray[Any, Any]) -> Any | None:
    from design.errors import DesignError
    from design.networked_loop.prediction import predict_tracking

    model, at = loop.model, loop.disturbance()
    gains = gains_over(controller, model, *chains)
    common: dict[str, Any] = {
        "period_s": model.period_s,
        "disturbance": np.array([at(k) for k in range(len(r))]),
        "samples": loop.samples,
        "integral": integrates(controller),
        "initial": initial_laws(loop.experiment),
    }
    arguments = (model.A, model.B, model.C, *chains, gains, controller.selection, r)
    try:
        error = predict_tracking(*arguments, **common)
        table = predict_tracking(*arguments, **common, target=target_of(r), sums_from=_starts(loop, len(r)))
    except (ValueError, DesignError):
        return None
    from dataclasses import replace

    return replace(error, sum_mean=table.sum_mean, sum_sd=table.sum_sd)


def _emulate(loop: Loop, names: list[str], ticks: int) -> np.ndarray[Any, Any] | None:
    """Return the errors of more runs, (runs, ticks, outputs); None if the runs are too long to make many."""
    count = min(RUNS, TICKS // ticks)
    if count < FEWEST:
        return None
    seeds = [1_000_000 + i for i in range(count)]
    columns = [[signal.name for signal in loop.experiment.plant.outputs].index(name) for name in names]
    found: dict[int, np.ndarray[Any, Any]] = {}
    if in_lockstep(loop):
        together = run_together(loop, seeds)
        errors = np.moveaxis(together.outputs[columns], 0, -1) - together.reference[:, None, columns]  # (slots, runs, outputs)
        found = {seed: errors[:ticks, i] for i, seed in enumerate(seeds) if together.known[i]}
    for seed in seeds:
        if seed in found:
            continue
        run = simulate(loop, seed, (MEASUREMENT, REFERENCE))
        y, r = (matrix(run.arrays[topic], names) for topic in (MEASUREMENT, REFERENCE))
        if len(y) >= ticks:  # one that safety stopped has no error to show
            found[seed] = (y - r)[:ticks]
    return np.array([found[seed] for seed in seeds if seed in found]) if len(found) >= FEWEST else None
