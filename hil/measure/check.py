"""`check_measure`: what every measure must fulfil. An author can run it; a user's own measures pass it before a run."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from numbers import Real
from typing import Any, Final

from msgspec.structs import replace

from hil.errors import ExperimentError, nearest
from hil.experiment import Experiment
from hil.log.records import EVENTS_TOPIC
from hil.log.topics import TOPICS
from hil.measure import Measure, made_of, own_measures, quantities_of, stated_by
from hil.measure.batch_protocols import BatchMeasure
from hil.measure.view import RunView
from hil.plugins.user_plugins import asked, in_own_words, needs

MEASURE: Final = {
    "title": "heading of its table",
    "note": "how its numbers are judged, may be empty",
    "topics": "what it reads of the log, a tuple such as ('/actuator/applied',)",
    "quantities": "quantities(signals) gives a Quantity for each number",
    "of": "of(view) gives the numbers of one run, by name",
}


def check_measure(measure: Any, view: RunView) -> list[str]:
    """Check a measure: names of its own, a finite number or None for each, also of a run that ended at once.

    Args:
        measure: an instance.
        view: a run that it shall measure.

    Returns:
        What the measure fulfils and what that earns, a sentence each.

    Raises:
        AssertionError: names what the measure does not fulfil.
    """
    name = type(measure).__name__
    needs(measure, f"{name}, a measure,", MEASURE)
    _check_topics(measure.topics)
    stated_by(measure, view.signals)
    names = [quantity.name for quantity in quantities_of([measure], view.signals)]
    if not names:
        raise AssertionError("a measure has at least one quantity")
    for what, one in (("a run", view), ("a run without records", view.without_records())):
        found = _numbers(measure, one, what)
        if set(found) != set(names):
            raise AssertionError(f"{what}: of(view) gives {sorted(found)}, quantities(signals) name {sorted(names)}")
        for key, value in found.items():
            if value is not None and (not isinstance(value, Real) or isinstance(value, bool)):
                shown = " ".join(repr(value).split())
                raise AssertionError(f"{what}: {key} is {shown:.80}, expected a number, or None where it is not defined")
            if value is not None and not math.isfinite(value):
                raise AssertionError(f"{what}: {key} is {value}; a number that is not defined is None")
    if (whole := _numbers(measure, view, "a run")) != _numbers(measure, view, "a run"):
        raise AssertionError("the same run must give the same numbers")
    kept = {topic: array for topic, array in view.run.arrays.items() if topic in measure.topics}
    of_those = view.of(replace(view.run, arrays=kept))
    if _numbers(measure, of_those, f"with {measure.topics} alone, its topics") != whole:
        raise AssertionError(f"with {measure.topics} alone, its topics, it gives other numbers: a sweep keeps no others")
    said = [f"{name} is a Measure: its numbers stand in summary, page, sweep and comparison"]
    if isinstance(measure, BatchMeasure):
        said.append(f"{name} is a BatchMeasure: a sweep asks it for all runs at once, and compares two with of(view)")
    else:
        said.append(f"{name} is no BatchMeasure (no of_batch): a sweep runs seed by seed")
    return said


def check_own_measures(experiment: Experiment, view: Callable[[], RunView]) -> None:
    """Refuse, before a run, a user's own measure that does not pass `check_measure`.

    A function is not checked: its number may need a longer run than the rehearsal.

    Args:
        experiment: names the measures.
        view: gives a short run of it, where one is needed.

    Raises:
        ExperimentError: with what each one does not keep.
    """
    faults, short = [], None
    for i, name, cls in own_measures(experiment):
        short = view() if short is None else short
        try:
            with in_own_words():
                check_measure(made_of(cls), short)
        except AssertionError as fault:
            faults.append(f"report.measures[{i}]: {name!r}: check_measure: {str(fault).partition(chr(10))[0]}")
    if faults:
        raise ExperimentError(experiment.name, faults)


def _check_topics(topics: object) -> None:
    known = [*TOPICS, EVENTS_TOPIC]
    if not isinstance(topics, tuple) or not all(isinstance(topic, str) for topic in topics):
        raise AssertionError(f"topics is {topics!r:.80}, expected a tuple of names, such as ('/actuator/applied',)")
    for topic in topics:
        if topic not in known:
            raise AssertionError(f"topics: no topic is called {topic!r}{nearest(topic, known)}")


def _numbers(measure: Measure, view: RunView, what: str) -> dict[str, Any]:
    found = asked(f"{what}: of(view)", measure.of, view)
    if not isinstance(found, Mapping):
        raise AssertionError(f"{what}: of(view) returned {found!r:.80}, expected numbers by name, such as {{'effort': 1.0}}")
    return dict(found)
