"""The run over time: outputs against their reference, states, input, delays, lateness; events marked on all.

A curve is made from its records block by block: a page of a long run holds no more than it draws.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from msgspec.structs import replace

from hil.log import topics
from hil.log.append_column import pieces
from hil.log.topics import STATE
from hil.measure import run_measures
from hil.measure.network_paths import network_paths
from hil.measure.summary import page_summary
from hil.measure.view import APPLIED, MEASUREMENT, REFERENCE, TIMING, RunView, Severity, seconds, signal_names
from hil.pages import Figure, LineStyle, Marker, Section, Series, State
from hil.pages.html import capital
from hil.pages.html.payload import Float, reduced
from hil.pages.sections.statistics import DIRECTIONS, MEASURED, network_table

Records: TypeAlias = npt.NDArray[np.void]
All: TypeAlias = Callable[[Records], npt.NDArray[np.bool_]]


def curve(
    records: Records,
    y: str | Callable[[Records], npt.NDArray[Any]],
    *,
    label: str,
    style: LineStyle = "line",
    where: All | None = None,
    x: Callable[[Records], Float] = seconds,
    **look: Any,
) -> Series:
    """Return a curve over session time.

    Args:
        records: of a topic.
        y: a field, or what to draw of some records.
        label, style: of the curve.
        where: which of some records are drawn; all by default.
        x: where they are drawn; at their session time by default.
        look: `colour`, `halo`, `faint` of the curve.
    """
    def blocks() -> Iterator[tuple[Float, Float]]:
        for piece in pieces(records):
            own = piece if where is None else piece[where(piece)]
            yield x(own), np.asarray(own[y] if isinstance(y, str) else y(own), dtype=np.float64)

    drawn_x, drawn_y, samples = reduced(blocks, step="step" in style)
    return Series(label=label, x=drawn_x, y=drawn_y, style=style, samples=samples, **look)


MOST_MARKERS = 500
DENSE = 1500
STACKED = 2
"""Up to so many states and inputs stand below the outputs; more stand side by side in a section of their own."""
STATES: Mapping[Severity, State] = {"neutral": "neutral", "warning": "warning", "error": "bad"}


def markers(view: RunView) -> tuple[Marker, ...]:
    """Return the marks of a run as lines on a time axis, labelled ones first."""
    found = [Marker(x=mark.t_s, label=mark.label, state=STATES[mark.severity]) for mark in view.marks]
    return tuple(sorted(found, key=lambda m: (m.label == "", m.x))[:MOST_MARKERS])


def follows_reference(view: RunView) -> bool:
    """Return whether the run has a reference: it is judged by one, or one is not zero. A wall has none."""
    judged = any(REFERENCE in measure.topics for measure in view.once(run_measures))
    reference = view.run.arrays[REFERENCE]
    return judged or any((piece[name] != 0.0).any() for piece in pieces(reference) for name in view.signals.tracked)


def _panel(view: RunView, name: str, unit: str, series: Sequence[Series], height_px: int, title: str = "") -> Figure:
    """Return a panel over time of what a signal's name says."""
    words = _words(name)
    return Figure(
        title=title or words.capitalize(), y_label=words, y_unit=unit, series=tuple(series), markers=view.once(markers),
        height_px=height_px,
    )  # fmt: skip


def tracking(view: RunView) -> Section | None:
    """Return outputs against their reference, with the few states and inputs that stand below them."""
    inside = view.once(_inside)
    blocks = (*output_panels(view), *(inside if len(inside) <= STACKED else ()))
    title = "Tracking" if follows_reference(view) else "Outputs"
    return Section(title=title, place=10, blocks=blocks) if blocks else None


def states(view: RunView) -> Section | None:
    """Return states and inputs where they are many."""
    inside = view.once(_inside)
    return Section(title="States and inputs", place=20, columns=2, blocks=inside) if len(inside) > STACKED else None


def _inside(view: RunView) -> tuple[Figure, ...]:
    return (*_state_panels(view), *_input_panels(view), *_topic_panels(view))


def output_panels(view: RunView) -> list[Figure]:
    """Return one panel per output: what was measured, the true state where it differs, and the reference where one is followed.

    An output that does not follow the reference (a measured mode) has none, and holds its value between samples.
    """
    arrays, tracked = view.run.arrays, view.signals.tracked
    measurement, reference, state = arrays[MEASUREMENT], arrays[REFERENCE], arrays.get(STATE.name)
    panels: list[Figure] = []
    followed = follows_reference(view)
    for name, unit in view.signals.outputs.items():
        style: LineStyle = "line" if name in tracked else "step"
        series = [curve(measurement, name, label=_words(name), style=style, colour=0)]
        if state is not None and name in (state.dtype.names or ()) and not _equal(state, measurement, name):
            series = [
                replace(series[0], label=f"{_words(name)}, measured", halo=True),
                curve(state, name, label=f"{_words(name)}, true", style=style, colour=0),
            ]
        if followed and name in tracked:
            series.insert(0, curve(reference, name, label="reference", style="dashed-step", colour=7))
        panels.append(_panel(view, name, unit, series, 220 if panels else 300))
    return panels


def _state_panels(view: RunView) -> list[Figure]:
    """Return one panel per state that is no output."""
    state = view.run.arrays.get(STATE.name)
    if state is None or not len(state):
        return []
    names = [name for name in signal_names(view.run, STATE.name) if name not in view.signals.outputs]
    curves = {name: curve(state, name, label=_words(name), colour=2) for name in names}
    return [_panel(view, name, view.unit(STATE.name, name), [own], 190) for name, own in curves.items()]


def _topic_panels(view: RunView) -> list[Figure]:
    """Return the panels of topics that no section of the page draws, as the topics say that they are plotted."""
    arrays, found = view.run.arrays, []
    own = [name for name, topic in topics.TOPICS.items() if not topic.paged and name in arrays]
    for title, curves in topics.panels(view.run.schemas, own).items():
        if all(len(arrays[name]) for name, _ in curves):
            series = [
                curve(arrays[name], each.field, label=_words(each.field), style="step", colour=number)
                for number, (name, each) in enumerate(curves)
            ]
            found.append(_panel(view, title, view.unit(curves[0][0], curves[0][1].field), series, 190))
    return found


def _input_panels(view: RunView) -> list[Figure]:
    """Return one panel per input: what was applied, and the disturbance that was added where there is one."""
    applied = view.run.arrays[APPLIED]
    panels = []
    for name, unit in view.signals.inputs.items():
        series = [curve(applied, name, label=f"{_words(name)}, commanded", style="step", colour=3)]
        w = f"w_{name}"
        if w in (applied.dtype.names or ()) and any((piece[w] != 0.0).any() for piece in pieces(applied)):
            series.insert(0, curve(applied, w, label="disturbance", style="step", colour=4))
        panels.append(_panel(view, name, unit, series, 200, title=f"Input: {_words(name)}"))
    return panels


def delays(view: RunView) -> Section:
    """Return the delays of both directions over time, and a row for each emulated network."""
    panels = [panel for side in DIRECTIONS if (panel := _delay_panel(view, side)) is not None]
    return Section(
        title="Delays",
        place=30,
        intro="The broad line is the delay that the emulated network drew, the thin line what the receiver measured "
        "from time stamps. They differ where a packet was late, lost or still on its way.",
        blocks=(*panels, network_table(view.once(page_summary)["network"], view.once(network_paths))),
    )


def _delay_panel(view: RunView, side: str) -> Figure | None:
    """Return the age that a direction's law drew, and the age that the receiver measured; None where neither was logged."""
    run, (way, symbol), (topic, field, known) = view.run, DIRECTIONS[side], MEASURED[side]
    series, draws, measured = [], run.arrays.get(f"/network/{side}"), run.arrays.get(topic)
    numbered = draws is not None and "node" in (draws.dtype.names or ())
    if draws is not None and not numbered and any((piece["age"][_own(piece)] >= 0).any() for piece in pieces(draws)):
        law = "sent" not in view.once(page_summary)["network"][side]["fates"]  # a packet law sends each
        look: tuple[str, LineStyle] = ("drawn by the law", "step") if law else ("age at arrival, by packet", "points")
        series.append(curve(draws, partial(_age, "age", "age"), label=look[0], style=look[1], where=_own, colour=1, halo=law))
    if measured is not None and len(measured):
        where = "measured by the controller" if side == "sc" else "measured at the actuator"
        series.append(curve(measured, partial(_age, field, known), label=where, style="step", colour=0))
    return Figure(
        title=f"{capital(way)} delay {symbol}", y_label=symbol, y_unit="samples", series=tuple(series),
        markers=view.once(markers), integer_y=True, height_px=165,
        note="Zoom in to see single slots." if len(run.arrays[APPLIED]) > DENSE else "",
    ) if series else None  # fmt: skip


def lateness(view: RunView) -> Section | None:
    """Return lateness and round trip over time; nothing for a run without measured times."""
    timing = view.run.arrays.get(TIMING)
    if timing is None or not len(timing):
        return None
    series = (
        curve(timing, partial(_at_least, "lateness_us"), label="lateness", colour=0),
        curve(timing, partial(_at_least, "round_trip_us"), label="round trip", colour=2),
    )
    panel = Figure(
        title="Lateness and round trip", y_label="time", y_unit="µs", y_log=True, series=series, markers=view.once(markers),
        height_px=220,
    )  # fmt: skip
    return Section(title="Timing", place=60, blocks=(panel,))


SECTIONS = (tracking, states, delays, lateness)


def _own(draws: Records) -> npt.NDArray[np.bool_]:
    chosen: npt.NDArray[np.bool_] = draws["mode"] >= 0
    return chosen


def _age(field: str, known: str, records: Records) -> npt.NDArray[np.float64]:
    return np.where(records[known] >= 0, records[field], np.nan).astype(np.float64)


def _at_least(field: str, timing: Records) -> npt.NDArray[np.float64]:
    return np.asarray(np.maximum(timing[field], 0.1), dtype=np.float64)


def _equal(a: Records, b: Records, name: str) -> bool:
    return all(np.array_equal(one[: len(other)][name], other[: len(one)][name]) for one, other in zip(pieces(a), pieces(b)))


def _words(name: str) -> str:
    return name.replace("_", " ")
