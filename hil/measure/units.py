"""The units of the tracking metrics, from those of the outputs and inputs."""

from __future__ import annotations

from collections.abc import Iterable

PURE = ("", "1")


def metric_units(outputs: Iterable[str], inputs: Iterable[str], mixed: str | None = None) -> dict[str, str]:
    """Return the unit of every metric; none for pure numbers, and for signals of several units whose common name is `mixed`.

    >>> metric_units(["rad"], ["V"])["sse"], metric_units(["deg/s"], ["1"])["sse"], metric_units(["kn", "deg"], ["1"])["sse"]
    ('rad² s', '(deg/s)² s', '')
    """
    y, u = _common(outputs, mixed), _common(inputs, None)
    base = f"({y})" if y and not y.isalpha() else y
    squared = "" if base is None else f"{base}² s" if base else "s"
    return {
        "sse": squared,
        "sse_after_5s": squared,
        "overshoot": "share of the step",
        "settling_time_s": "s",
        "steady_state_error": y or "",
        "max_abs_u": u or "",
    }


def with_unit(text: str, unit: str) -> str:
    """Return a label with its unit in brackets.

    >>> with_unit("angle", "rad"), with_unit("mode", "1")
    ('angle (rad)', 'mode')
    """
    return text if unit in PURE else f"{text} ({unit})"


def _common(units: Iterable[str], mixed: str | None) -> str | None:
    found = {"" if unit in PURE else unit for unit in units}
    return found.pop() if len(found) == 1 else mixed
