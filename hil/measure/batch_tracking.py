"""How well the outputs of many runs followed one reference: `tracking_metrics` for all of them at once, bit for bit."""

from __future__ import annotations

import numpy as np

from hil.measure.batch_measure import BatchValues, BatchView
from hil.measure.step_response import AFTER_S, SETTLED_SHARE, SETTLING_BAND, STEADY_SHARE, target_of


def tracking_of_batch(view: BatchView) -> dict[str, BatchValues]:
    """Return the numbers of `hil.measure.tracking.tracking_metrics` for many runs, (runs,) each, NaN for None.

    Args:
        view: the runs, at least one slot long.
    """
    t, reference, runs, n = view.t_s, view.reference, len(view.inputs[0]), len(view.t_s)
    nothing = np.full(runs, np.nan)
    target = target_of(reference)
    errors = [y - c for y, c in zip(view.outputs, target.T)]
    squared = errors[0] ** 2 if len(errors) == 1 else np.sum(np.stack(errors, axis=-1) ** 2, axis=-1)
    begin = int(np.searchsorted(t, AFTER_S - 1e-9))
    last = max(round(STEADY_SHARE * n), 1)
    found = {
        "sse": view.period_s * squared.sum(axis=1),
        "sse_after_5s": view.period_s * squared[:, begin:].sum(axis=1) if begin < n else nothing,
        "overshoot": nothing,
        "settling_time_s": nothing,
        "steady_state_error": _worst([error[:, -last:].mean(axis=1) for error in errors]),
        "max_abs_u": np.maximum.reduce([np.abs(u).max(axis=1) for u in view.inputs]),
    }
    changes = np.flatnonzero(np.any(reference[1:] != reference[:-1], axis=1)) + 1
    if changes.size:
        first, end = int(changes[0]), int(changes[1]) if changes.size > 1 else n
        if view.disturbed_at_s is not None and view.disturbed_at_s > t[first]:
            end = min(end, int(np.searchsorted(t, view.disturbed_at_s - 1e-9)))
        step = reference[first] - reference[first - 1]
        moved = [(error[:, first:end], s) for error, s in zip(errors, step) if s != 0.0]
        if moved and end > first:
            beyond = np.maximum.reduce([(error / s).max(axis=1) for error, s in moved])
            found["overshoot"] = 100.0 * np.maximum(beyond, 0.0)
            found["settling_time_s"] = _settling(t[first:end], moved)
    return found


def _settling(t: BatchValues, moved: list[tuple[BatchValues, float]]) -> BatchValues:
    inside = np.logical_and.reduce([np.abs(error) <= SETTLING_BAND * abs(step) for error, step in moved])
    after = inside.shape[1] - np.argmin(inside[:, ::-1], axis=1)  # first slot after the last one outside
    after[inside.all(axis=1)] = 0
    stays = inside[:, -max(round(SETTLED_SHARE * len(t)), 1) :].all(axis=1)
    return np.where(stays, t[np.minimum(after, len(t) - 1)] - t[0], np.nan)


def _worst(means: list[BatchValues]) -> BatchValues:
    worst = means[0]
    for mean in means[1:]:
        worst = np.where(np.abs(mean) > np.abs(worst), mean, worst)
    return worst
