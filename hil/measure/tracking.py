"""How well the outputs followed the reference."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import ClassVar, TypeAlias

import numpy as np
import numpy.typing as npt

from hil.measure import Quantity
from hil.measure.batch_protocols import BatchView
from hil.measure.signals import AFTER_S, SETTLED_SHARE, SETTLING_BAND, STEADY_SHARE, Followed, Signals, pairwise_sum, target_of
from hil.measure.view import APPLIED, MEASUREMENT, REFERENCE, REFERENCE_STEP, RunView

Array: TypeAlias = npt.NDArray[np.float64]


class Tracking:
    """The measure of the thesis: squared error, step response, largest input; see `tracking_metrics`."""

    title: ClassVar[str] = "Tracking"
    note: ClassVar[str] = (
        "Before the first step the error counts against the value stepped to, as in Table 7.2. Overshoot and settling time are "
        "judged up to the first disturbance."
    )

    topics: ClassVar[tuple[str, ...]] = (MEASUREMENT, REFERENCE, APPLIED)

    def quantities(self, signals: Signals) -> tuple[Quantity, ...]:
        """Return the numbers with their units, which are those of the tracked outputs and of the inputs.

        Inputs of several units have no largest one.
        """
        unit, squared, of_inputs = signals.tracked_unit() or "", squared_unit(signals), signals.input_unit()
        largest = Quantity(name="max_abs_u", title="largest input", unit=of_inputs or "", per_output=False)
        return (
            Quantity(name="sse", title="squared tracking error", unit=squared, note="whole run, × T", better="lower"),
            Quantity(name="sse_after_5s", title="squared error after 5 s", unit=squared, note="× T", better="lower"),
            Quantity(name="overshoot", title="overshoot", unit="%", note="of the step", needs=REFERENCE_STEP),
            Quantity(
                name="settling_time_s", title="settling time", unit="s", note="to 2 %", absent="not settled to 2 %",
                needs=REFERENCE_STEP,
            ),
            Quantity(name="steady_state_error", title="steady-state error", unit=unit, note="last tenth"),
            *([] if of_inputs is None else [largest]),
        )  # fmt: skip

    def of(self, view: RunView) -> dict[str, float | None]:
        """Return the numbers of one run; what would add or compare outputs of several units is None."""
        found = tracking_metrics(view.followed(), view.inputs(), view.period_s, disturbed_at_s=view.disturbed_at_s())
        found |= dict.fromkeys(without_sense(view.signals))
        return {q.name: found[q.name] for q in self.quantities(view.signals)}

    def of_batch(self, view: BatchView) -> dict[str, Array]:
        """Return the numbers of many runs, (runs,) each, NaN where one is not defined."""
        found = tracking_of_batch(view)
        found |= {name: np.full_like(found[name], np.nan) for name in without_sense(view.signals)}
        return {q.name: found[q.name] for q in self.quantities(view.signals)}


def without_sense(signals: Signals) -> tuple[str, ...]:
    """Return the numbers that would add or compare outputs of several units; of each output alone they are defined.

    >>> without_sense(Signals(outputs={"angle": "rad", "place": "m"}, inputs={"u": "V"}, tracked=("angle", "place")))
    ('sse', 'sse_after_5s', 'steady_state_error')
    """
    several = len(signals.tracked) > 1 and signals.tracked_unit() is None
    return ("sse", "sse_after_5s", "steady_state_error") if several else ()


def squared_unit(signals: Signals) -> str:
    """Return the unit of a squared tracking error summed over time; nothing where the outputs have several units.

    >>> squared_unit(Signals(outputs={"w": "deg/s"}, inputs={}, tracked=("w",)))
    '(deg/s)² s'
    """
    unit = signals.tracked_unit()
    if unit is None:
        return ""
    base = f"({unit})" if unit and not unit.isalpha() else unit
    return f"{base}² s" if base else "s"


def tracking_metrics(
    run: Followed, inputs: Iterable[Array], period_s: float, *, disturbed_at_s: float | None = None
) -> dict[str, float | None]:
    """Return the numbers of Table 7.2 and the usual marks of a step response.

    The error of sample k is e(k) = y(k) - c(k), with the *target* c(k) = r(k) from the first change of the reference
    on, and before it c(k) = the value that the reference then takes. So the time before the step counts as error too,
    as in Table 7.2 (of its 11.29 rad^2 s, 3 rad squared times 1 s = 9 fall before the step), and

        sse = T * sum_k |e(k)|^2,        sse_after_5s = T * sum over t_k >= 5 s of |e(k)|^2.

    A reference without a change is its own target. Overshoot and settling time belong to the first step: the window
    runs from it to the next change of the reference, to `disturbed_at_s` or to the end, whichever comes first.

    Args:
        run: outputs and reference, read in blocks.
        inputs: blocks of the applied input, (., m); only its largest absolute value is used.
        period_s: sample period T in s.
        disturbed_at_s: begin of the first input disturbance in s, None if there is none.

    Returns (None where it is not defined, e.g. without a step, without samples, or for values that are not finite):
        sse, sse_after_5s: squared unit of the outputs times s, summed over the outputs.
        overshoot: largest excursion beyond the target in % of the step, >= 0; the worst output.
        settling_time_s: from the step until |e| stays within 2 % of the step; the slowest output; None if one is not
            within it for the last tenth of the window at least.
        steady_state_error: mean of y - c over the last tenth of the run, signed; the output where it is largest.
        max_abs_u: largest |u|.

    Reference: section 7.5, Table 7.2.

    >>> t = np.arange(0.0, 10.0, 0.5)[:, None]
    >>> r = np.where(t < 1.0, 0.0, 3.0)
    >>> perfect = tracking_metrics(Followed(slots=20, of=lambda i, j: (t[i:j, 0], r[i:j], r[i:j])), [], 0.5)
    >>> perfect["sse"], perfect["overshoot"], perfect["settling_time_s"]
    (9.0, 0.0, 0.0)
    """
    none = dict.fromkeys(("sse", "sse_after_5s", "overshoot", "settling_time_s", "steady_state_error"))
    found: dict[str, float | None] = {**none, "max_abs_u": _largest(inputs)}
    n = run.slots
    if n == 0:
        return found
    changes = run.changes(2)
    with np.errstate(over="ignore", invalid="ignore"):
        error = _Error(run, changes[0] if changes else 0)
        found["sse"] = _finite(period_s * pairwise_sum(error.squared, n))
        begin = run.first_at(AFTER_S - 1e-9)
        found["sse_after_5s"] = _finite(period_s * pairwise_sum(error.squared, n - begin, begin)) if begin < n else None
        last = max(round(STEADY_SHARE * n), 1)
        columns = [partial(error.output, c) for c in range(error.outputs)]
        found["steady_state_error"] = _worst([_finite(pairwise_sum(column, last, n - last) / last) for column in columns])
        if changes:
            first, end = changes[0], changes[1] if len(changes) > 1 else n
            if disturbed_at_s is not None and disturbed_at_s - 1e-9 > run.time(first):
                end = min(end, run.first_at(disturbed_at_s - 1e-9))
            step = run.reference(first) - run.reference(first - 1)
            found["overshoot"] = _overshoot(run, error, step, first, end)
            found["settling_time_s"] = _settling(run, error, step, first, end)
    return found


class _Error:
    """The error against the target: the reference, and before its first change the value that it goes to."""

    def __init__(self, run: Followed, change: int) -> None:
        self._run, self._change, self._goal = run, change, run.reference(change)
        self.outputs = len(self._goal)

    def of(self, i: int, j: int) -> Array:
        _, y, r = self._run.of(i, j)
        if i < self._change:
            r = r.copy()
            r[: self._change - i] = self._goal
        return y - r

    def squared(self, i: int, j: int) -> Array:
        total: Array = np.sum(self.of(i, j) ** 2, axis=1)
        return total

    def output(self, column: int, i: int, j: int) -> Array:
        return self.of(i, j)[:, column]


def _overshoot(run: Followed, error: _Error, step: Array, first: int, end: int) -> float | None:
    """By how much an output went beyond its target at most, in % of the step."""
    moved = step != 0.0
    most = [float(np.max(error.of(i, j)[:, moved] / step[moved])) for i, j in run.blocks(first, end)]
    return _finite(100.0 * max(float(np.max(most)), 0.0))


def _settling(run: Followed, error: _Error, step: Array, first: int, end: int) -> float | None:
    """Time from the step after which every output stays within its band."""
    moved = step != 0.0
    band = SETTLING_BAND * np.abs(step[moved])
    last = None
    for i, j in reversed([*run.blocks(first, end)]):
        # Not "outside the band": a NaN is not inside either.
        outside = np.flatnonzero(~np.all(np.abs(error.of(i, j)[:, moved]) <= band, axis=1))
        if outside.size:
            last = i + int(outside[-1])
            break
    if last is None:
        return 0.0
    if last >= end - max(round(SETTLED_SHARE * (end - first)), 1):
        return None
    return run.time(last + 1) - run.time(first)


def _largest(blocks: Iterable[Array]) -> float | None:
    found = [float(np.max(np.abs(finite))) for block in blocks if (finite := block[np.isfinite(block)]).size]
    return max(found, default=None)


def _worst(values: list[float | None]) -> float | None:
    if not values or any(v is None for v in values):
        return None
    return max((v for v in values if v is not None), key=abs)


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def tracking_of_batch(view: BatchView) -> dict[str, Array]:
    """Return the numbers of `tracking_metrics` for many runs, (runs,) each, NaN for None.

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
        "steady_state_error": _worst_of_batch([error[:, -last:].mean(axis=1) for error in errors]),
        "max_abs_u": np.maximum.reduce([np.abs(u).max(axis=1) for u in view.inputs]),
    }
    changes = np.flatnonzero(np.any(reference[1:] != reference[:-1], axis=1)) + 1
    if changes.size:
        first, end = int(changes[0]), int(changes[1]) if changes.size > 1 else n
        if view.disturbed_at_s is not None and view.disturbed_at_s - 1e-9 > t[first]:
            end = min(end, int(np.searchsorted(t, view.disturbed_at_s - 1e-9)))
        step = reference[first] - reference[first - 1]
        moved = [(error[:, first:end], s) for error, s in zip(errors, step) if s != 0.0]
        beyond = np.maximum.reduce([(error / s).max(axis=1) for error, s in moved])
        found["overshoot"] = 100.0 * np.maximum(beyond, 0.0)
        found["settling_time_s"] = _settling_of_batch(t[first:end], moved)
    return found


def _settling_of_batch(t: Array, moved: list[tuple[Array, float]]) -> Array:
    inside = np.logical_and.reduce([np.abs(error) <= SETTLING_BAND * abs(step) for error, step in moved])
    after = inside.shape[1] - np.argmin(inside[:, ::-1], axis=1)  # first slot after the last one outside
    after[inside.all(axis=1)] = 0
    stays = inside[:, -max(round(SETTLED_SHARE * len(t)), 1) :].all(axis=1)
    return np.where(stays, t[np.minimum(after, len(t) - 1)] - t[0], np.nan)


def _worst_of_batch(means: list[Array]) -> Array:
    worst = means[0]
    for mean in means[1:]:
        worst = np.where(np.abs(mean) > np.abs(worst), mean, worst)
    return worst
