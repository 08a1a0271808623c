"""How well the outputs followed the reference."""

from __future__ import annotations

from typing import Any, ClassVar, TypeAlias

import numpy as np
import numpy.typing as npt

from hil.measure.many import Many, ManyView
from hil.measure.measure import Quantity
from hil.measure.signals import Signals
from hil.measure.step_response import AFTER_S, SETTLED_SHARE, SETTLING_BAND, STEADY_SHARE, target_of
from hil.measure.tracking_many import tracking_of_many
from hil.measure.view import APPLIED, MEASUREMENT, REFERENCE, REFERENCE_STEP, RunView

Array: TypeAlias = npt.NDArray[np.floating[Any]]


class Tracking:
    """The measure of the thesis: squared error, step response, largest input; see `tracking_metrics`."""

    title: ClassVar[str] = "Tracking"
    note: ClassVar[str] = (
        "Before the first step the error counts against the value stepped to, as in Table 7.2. Overshoot and settling time are "
        "judged up to the first disturbance."
    )

    topics: ClassVar[tuple[str, ...]] = (MEASUREMENT, REFERENCE, APPLIED)

    def quantities(self, signals: Signals) -> tuple[Quantity, ...]:
        """Return the six numbers with their units, which are those of the tracked outputs and of the inputs."""
        unit, squared = signals.tracked_unit() or "", squared_unit(signals)
        return (
            Quantity(name="sse", title="squared tracking error", unit=squared, note="whole run, × T", better="lower"),
            Quantity(name="sse_after_5s", title="squared error after 5 s", unit=squared, note="× T", better="lower"),
            Quantity(name="overshoot", title="overshoot", share_of="the step", needs=REFERENCE_STEP),
            Quantity(
                name="settling_time_s", title="settling time", unit="s", note="to 2 %", absent="not settled to 2 %",
                needs=REFERENCE_STEP,
            ),
            Quantity(name="steady_state_error", title="steady-state error", unit=unit, note="last tenth"),
            Quantity(name="max_abs_u", title="largest input", unit=signals.input_unit() or "", per_output=False),
        )  # fmt: skip

    def of(self, view: RunView) -> dict[str, float | None]:
        """Return the numbers of one run; what would add or compare outputs (or inputs) of several units is None."""
        t, y, r = view.tracking()
        found = tracking_metrics(t, y, r, view.applied(), view.period_s, disturbed_at_s=view.disturbed_at_s())
        return found | dict.fromkeys(without_sense(view.signals))

    def of_many(self, view: ManyView) -> dict[str, Many]:
        """Return the numbers of many runs, (runs,) each, NaN where one is not defined."""
        found = tracking_of_many(view)
        return found | {name: np.full_like(found[name], np.nan) for name in without_sense(view.signals)}


def without_sense(signals: Signals) -> tuple[str, ...]:
    """Return the numbers that would add or compare signals of several units; of each output alone they are defined.

    >>> without_sense(Signals(outputs={"angle": "rad", "place": "m"}, inputs={"u": "V"}, tracked=("angle", "place")))
    ('sse', 'sse_after_5s', 'steady_state_error')
    """
    errors = ("sse", "sse_after_5s", "steady_state_error") if len(signals.tracked) > 1 and signals.tracked_unit() is None else ()
    inputs = ("max_abs_u",) if len(signals.inputs) > 1 and signals.input_unit() is None else ()
    return (*errors, *inputs)


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
    t: Array, y: Array, r: Array, u: Array, period_s: float, *, disturbed_at_s: float | None = None
) -> dict[str, float | None]:
    """Return the numbers of Table 7.2 and the usual marks of a step response.

    The error of sample k is e(k) = y(k) - c(k), with the *target* c(k) = r(k) from the first change of the reference
    on, and before it c(k) = the value that the reference then takes. So the time before the step counts as error too,
    as in Table 7.2 (of its 11.29 rad^2 s, 3 rad squared times 1 s = 9 fall before the step), and

        sse = T * sum_k |e(k)|^2,        sse_after_5s = T * sum over t_k >= 5 s of |e(k)|^2.

    A reference without a change is its own target. Overshoot and settling time belong to the first step: the window
    runs from it to the next change of the reference, to `disturbed_at_s` or to the end, whichever comes first.

    Args:
        t: session time of the samples in s, (n,).
        y, r: outputs and reference, (n,) or (n, p).
        u: applied input, (n_u,) or (n_u, m); only its largest absolute value is used.
        period_s: sample period T in s.
        disturbed_at_s: begin of the first input disturbance in s, None if there is none.

    Returns (None where it is not defined, e.g. without a step, without samples, or for values that are not finite):
        sse, sse_after_5s: squared unit of the outputs times s, summed over the outputs.
        overshoot: largest excursion beyond the target as a share of the step, >= 0; the worst output.
        settling_time_s: from the step until |e| stays within 2 % of the step; the slowest output; None if one is not
            within it for the last tenth of the window at least.
        steady_state_error: mean of y - c over the last tenth of the run, signed; the output where it is largest.
        max_abs_u: largest |u|.

    Reference: section 7.5, Table 7.2.

    >>> t = np.arange(0.0, 10.0, 0.5)
    >>> r = np.where(t < 1.0, 0.0, 3.0)
    >>> perfect = tracking_metrics(t, r, r, np.zeros(20), 0.5)
    >>> perfect["sse"], perfect["overshoot"], perfect["settling_time_s"]
    (9.0, 0.0, 0.0)
    """
    outputs, reference = _columns(y), _columns(r)
    none = dict.fromkeys(("sse", "sse_after_5s", "overshoot", "settling_time_s", "steady_state_error"))
    found: dict[str, float | None] = {**none, "max_abs_u": _largest(np.asarray(u, dtype=np.float64))}
    n = min(len(t), len(outputs), len(reference))
    if n == 0:
        return found
    t, outputs, reference = np.asarray(t, dtype=np.float64)[:n], outputs[:n], reference[:n]
    changes = np.flatnonzero(np.any(reference[1:] != reference[:-1], axis=1)) + 1
    target = target_of(reference)
    with np.errstate(over="ignore", invalid="ignore"):
        error = outputs - target
        squared = np.sum(error**2, axis=1)
        found["sse"] = _finite(period_s * float(np.sum(squared)))
        after = t >= AFTER_S - 1e-9
        found["sse_after_5s"] = _finite(period_s * float(np.sum(squared[after]))) if after.any() else None
        last = error[-max(round(STEADY_SHARE * n), 1) :]
        means = [_finite(float(np.mean(column))) for column in last.T]
        found["steady_state_error"] = _worst(means)
        if changes.size:
            end = int(changes[1]) if changes.size > 1 else n
            if disturbed_at_s is not None and disturbed_at_s > t[changes[0]]:
                end = min(end, int(np.searchsorted(t, disturbed_at_s - 1e-9)))
            first = int(changes[0])
            step = reference[first] - reference[first - 1]
            moved = step != 0.0
            found["overshoot"] = _overshoot(error[first:end, moved], step[moved])
            found["settling_time_s"] = _settling(t[first:end], error[first:end, moved], step[moved])
    return found


def _overshoot(error: Array, step: Array) -> float | None:
    """Largest share of the step by which an output went beyond its target."""
    if error.size == 0:
        return None
    return _finite(max(float(np.max(error / step)), 0.0))


def _settling(t: Array, error: Array, step: Array) -> float | None:
    """Time from the step after which every output stays within its band."""
    if error.size == 0:
        return None
    # Not "outside the band": a NaN is not inside either.
    outside = ~np.all(np.abs(error) <= SETTLING_BAND * np.abs(step), axis=1)
    if outside[-max(round(SETTLED_SHARE * len(t)), 1) :].any():
        return None
    last = np.flatnonzero(outside)
    return float(t[last[-1] + 1] - t[0]) if last.size else 0.0


def _columns(values: Array) -> Array:
    array = np.asarray(values, dtype=np.float64)
    return array[:, None] if array.ndim == 1 else array


def _largest(values: Array) -> float | None:
    finite = values[np.isfinite(values)]
    return float(np.max(np.abs(finite))) if finite.size else None


def _worst(values: list[float | None]) -> float | None:
    if not values or any(v is None for v in values):
        return None
    return max((v for v in values if v is not None), key=abs)


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
