"""What every measure must keep, as a function that its author can run."""

from __future__ import annotations

import math
from dataclasses import replace

from hil.measure.measure import Measure, quantities_of
from hil.measure.view import RunView


def check_measure(measure: object, view: RunView) -> None:
    """Check a measure: names of its own, a finite number or None for each, also of a run that ended at once.

    Args:
        measure: an instance.
        view: a run that it shall measure.

    Raises:
        AssertionError: what it does not keep, in a sentence.
    """
    if not isinstance(measure, Measure):
        raise AssertionError("a measure has title, note, topics, quantities(signals) and of(view)")
    names = [quantity.name for quantity in quantities_of([measure], view.signals)]
    if not names:
        raise AssertionError("a measure has at least one quantity")
    empty = replace(view, run=replace(view.run, arrays={topic: a[:0] for topic, a in view.run.arrays.items()}, events=[]))
    for what, one in (("the run", view), ("a run without records", empty)):
        found = measure.of(one)
        if set(found) != set(names):
            raise AssertionError(f"{what}: of(view) gives {sorted(found)}, quantities(signals) name {sorted(names)}")
        for name, value in found.items():
            if value is not None and not math.isfinite(value):
                raise AssertionError(f"{what}: {name} is {value}; a number that is not defined is None")
    kept = {topic: array for topic, array in view.run.arrays.items() if topic in measure.topics}
    if measure.of(replace(view, run=replace(view.run, arrays=kept))) != measure.of(view):
        raise AssertionError("with its topics alone it gives other numbers: a sweep keeps no others")
    if measure.of(view) != measure.of(view):
        raise AssertionError("the same run must give the same numbers")
