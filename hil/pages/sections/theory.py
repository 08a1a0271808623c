"""Theory and emulation on one picture: the predicted tracking error, the run, and many more runs of the same experiment."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from msgspec import structs

from hil.compose.judged import caution
from hil.measure.network_paths import changed_fields
from hil.measure.prediction import PredictedTracking, predict
from hil.measure.signals import target_of, with_unit
from hil.measure.summary import controller_of
from hil.measure.view import MEASUREMENT, REFERENCE, RunView, matrix
from hil.pages import Band, Block, Figure, Section, Series, Table
from hil.pages.html import capital
from hil.rig.loop import Loop
from hil.runtime.virtual import simulate
from hil.session.replay.avatar import composed
from hil.sweeps.lockstep import run_batch, supports_batch

RUNS = 100
SLOTS = 120_000  # of emulation that a page may cost: some 3 s
FEWEST = 20
MOST_SLOTS = 100_000
"""Slots that are predicted at most: the first ones of a longer run."""
MOST_MOMENTS = 4_000_000
"""Modes of the network times slots that are predicted at most: some 10 s."""


def section(view: RunView) -> Section | None:
    """Return the panels of predicted mean and spread, with the run and a Monte Carlo band over them.

    None where there is no prediction, see `hil.measure.prediction.predict`, or where the log's experiment cannot be made
    again or was changed in the run.
    """
    another = controller_of(view.run) == "external" or changed_fields(view.run)  # than the experiment's loop
    loop = None if another else view.once(composed)
    if loop is None:
        return None
    recorded = min(len(view.run.arrays[topic]) for topic in (MEASUREMENT, REFERENCE))
    slots = min(recorded, MOST_SLOTS, MOST_MOMENTS // _modes(loop))
    predicted = predict(loop, slots) if slots >= 2 else None
    if predicted is None:
        return None
    names = list(predicted.names)
    y, r = (matrix(view.run.arrays[topic][:slots], names) for topic in (MEASUREMENT, REFERENCE))
    part = "" if slots == recorded else f" All numbers are of the first {slots} slots of {recorded}."
    left = f" It leaves out: {', '.join(predicted.left_out)}." if predicted.left_out else ""
    within = "A run lies in the band most of the time." if not left else "So a run may leave the band."
    return Section(
        title="Theory and emulation",
        place=120,
        blocks=(*_errors(loop, view, predicted, y - r), _sums(loop, predicted, y - target_of(r), bool(left))),
        intro=(
            "The covariance recursion of the jump-linear loop predicts the error from the first slot on: from the plant's linear "
            "model, its first state, known disturbances and loads, the gains and the chains of delays. It knows no limit that "
            f"stops a run.{left} {within}{part}"
        ),
    )


SECTIONS = (section,)


def _modes(loop: Loop) -> int:
    sc, ca = loop.chains.sc, loop.chains.ca
    return 1 if sc is None or ca is None else sc.modes * ca.modes


def _errors(loop: Loop, view: RunView, predicted: PredictedTracking, error: np.ndarray[Any, Any]) -> list[Block]:
    slots = len(error)
    many = _emulate(loop, list(predicted.names), slots)
    t = np.arange(slots) * loop.model.period_s
    blocks: list[Block] = []
    for c, name in enumerate(predicted.names):
        mean, sd = predicted.error_mean[:, c], predicted.error_sd[:, c]
        bands = [Band(label="predicted mean ± 2 sd", x=t, lower=mean - 2 * sd, upper=mean + 2 * sd, colour=2)]
        if many is not None:
            low, high = np.percentile(many[:, :, c], (2.5, 97.5), axis=0)
            bands.append(Band(label=f"95 % of {len(many)} more runs", x=t, lower=low, upper=high, colour=0))
        blocks.append(
            Figure(
                title=f"Tracking error of {name.replace('_', ' ')}",
                series=(
                    Series(label="predicted mean", x=t, y=mean, style="dashed", colour=2),
                    Series(label="this run", x=t, y=error[:, c], colour=1),
                ),
                bands=tuple(bands),
                y_label="error",
                y_unit=view.signals.outputs[name],
                height_px=280,
            )
        )
    return blocks


def _sums(loop: Loop, predicted: PredictedTracking, error: np.ndarray[Any, Any], simplified: bool) -> Table:
    """The squared errors of the tracked outputs; where these have several units, a row for each."""
    rows: list[list[Any]] = []
    units = {each.unit for each in predicted.sums}
    for each in predicted.sums:
        own = error[each.start :, [predicted.names.index(name) for name in each.outputs]]
        title = each.title if len(units) == 1 else with_unit(each.title, each.unit)
        rows.append([title, each.mean, each.sd, float((own**2).sum() * loop.model.period_s)])
    whose = "linear model" if simplified else "predicted"
    tails = caution(loop)
    head = with_unit("squared tracking error", units.pop()) if len(units) == 1 else "squared tracking error"
    return Table(
        columns=(head, f"{whose} mean", f"{whose} sd", "this run"),
        rows=rows,
        note="Squared error of the tracked outputs against the value stepped to, summed over the samples, times T: Table 7.2."
        + (f" {capital(tails)}." if tails else ""),
    )


def _emulate(loop: Loop, names: list[str], slots: int) -> np.ndarray[Any, Any] | None:
    """Return the errors of more runs of so many slots, (runs, slots, outputs); None if they are too long to make many."""
    count = min(RUNS, SLOTS // slots)
    if count < FEWEST:
        return None
    loop = replace(loop, experiment=structs.replace(loop.experiment, duration=slots * loop.experiment.period))
    seeds = [1_000_000 + i for i in range(count)]
    columns = [[signal.name for signal in loop.experiment.plant.outputs].index(name) for name in names]
    found: dict[int, np.ndarray[Any, Any]] = {}
    if supports_batch(loop):
        together = run_batch(loop, seeds, topics=())
        errors = np.moveaxis(together.outputs[columns], 0, -1) - together.reference[:, None, columns]  # (slots, runs, outputs)
        found = {seed: errors[:, i] for i, seed in enumerate(seeds) if together.known[i]}
    for seed in (each for each in seeds if each not in found):
        run = simulate(loop, seed, (MEASUREMENT, REFERENCE))
        y, r = (matrix(run.arrays[topic], names) for topic in (MEASUREMENT, REFERENCE))
        if len(y) == slots:  # one that safety stopped has no error to show
            found[seed] = y - r
    return np.array([found[seed] for seed in seeds if seed in found]) if len(found) >= FEWEST else None
