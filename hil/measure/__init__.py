"""Numbers of a run, no pictures. A measure gives those of one kind by name; it is a plug-in of the group `hil.measures`.

A name that is not there is answered with those that are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from numbers import Real
from types import FunctionType
from typing import Any, ClassVar, Literal, Protocol, TypeVar, runtime_checkable

from msgspec import Struct, ValidationError, convert
from msgspec.structs import asdict, replace

from hil.errors import HilError, located, unknown_name
from hil.experiment import Experiment
from hil.experiment.tables import Report
from hil.log.records import EVENTS_TOPIC
from hil.log.run import Run
from hil.log.topics import NUMBER_TOPICS
from hil.measure.signals import Signals
from hil.measure.view import RunView, view_of
from hil.plugins import registry
from hil.plugins.user_plugins import asked, in_own_words, words
from hil.rig.loop import Loop


class Quantity(Struct, frozen=True, kw_only=True):
    """One number of a measure, as summaries, sweeps, tables, tiles and comparisons name it.

    Args:
        name: key in a summary and column of a sweep.
        title: what people read.
        unit: its unit; nothing for a pure number, or where the signals have several units.
        note: how it is judged, a few words.
        absent: what None means in a run that has had what it `needs`.
        needs: label of the mark without which it is not defined, such as "reference step".
        better: which values are better, where that can be said; a comparison is judged by the first that has it.
        per_output: whether it is also given for every tracked output.
    """

    name: str
    title: str
    unit: str = ""
    note: str = ""
    absent: str = ""
    needs: str = ""
    better: Literal["", "lower", "higher"] = ""
    per_output: bool = True


@runtime_checkable
class Measure(Protocol):
    """Numbers of a run; `check_measure` says to an author whether his class is one.

    The class is named by an entry point of the group `hil.measures`, made without arguments, and chosen by an experiment:
    `[report] measures = ["tracking", "mine"]`.

    Args:
        title: heading of its table.
        note: how its numbers are judged, a sentence or two; may be empty.
        topics: of the log that it reads: a sweep keeps no others.
    """

    @property
    def title(self) -> str: ...

    @property
    def note(self) -> str: ...

    @property
    def topics(self) -> tuple[str, ...]: ...

    def quantities(self, signals: Signals) -> Sequence[Quantity]:
        """Return what it measures over these signals, in the order of a table."""

    def of(self, view: RunView) -> Mapping[str, float | None]:
        """Return its numbers for one run, by name; None where one is not defined. Finite, whatever the run holds."""


def measures_of(experiment: Experiment | None) -> tuple[Measure, ...]:
    """Return the measures that an experiment asks for, the default ones without an experiment.

    Raises:
        HilError: a plug-in that is no measure, or two that give one name to two numbers.
    """
    report = experiment.report if experiment is not None else Report()
    found = []
    for name in report.measures:
        made = registry.load("hil.measures", name, experiment.folder if experiment is not None else ".")
        with located(f"report.measures: {name!r}", AssertionError), in_own_words():
            measure = made_of(made)
        if not isinstance(measure, Measure):
            lacks = "title, note, topics, quantities(signals) or of(view)"
            raise HilError(f"report.measures: {name!r} is no measure: it lacks {lacks}")
        found.append(measure)
    return tuple(found)


def own_measures(experiment: Experiment) -> list[tuple[int, str, Any]]:
    """Return the classes of measures that an experiment asks for and that are not ours: their place, name and class."""
    found = []
    for i, name in enumerate(experiment.report.measures):
        cls: Any = registry.load("hil.measures", name, experiment.folder)
        if not isinstance(cls, FunctionType) and cls.__module__.partition(".")[0] != "hil":
            found.append((i, name, cls))
    return found


def refuse_unsound_measures(loop: Loop, rehearsal: Callable[[Loop], Run]) -> None:
    """Hold measures of the user's own to `check_measure`, over a short run; see `hil.measure.check.check_own_measures`."""
    if own_measures(loop.experiment):
        from hil.measure.check import check_own_measures

        check_own_measures(loop.experiment, lambda: view_of(rehearsal(loop), loop.experiment, loop.rig))


def made_of(plugin: object) -> object:
    """Return the measure that a plug-in stands for: an instance of a class, the one number of a function, else the object.

    Args:
        plugin: what a name of `[report] measures` loads.
    """
    if isinstance(plugin, FunctionType):
        return MeasureOfFunction(plugin)
    return plugin() if isinstance(plugin, type) else plugin


def run_measures(view: RunView) -> tuple[Measure, ...]:
    """Return the measures that a run is judged by: `view.once(run_measures)`."""
    return measures_of(view.experiment)


class MeasureOfFunction:
    """What a function of the user's own returns, under the function's name: ``hil sweep --metric module:function``.

    Args:
        function: takes a `RunView` and returns a number, or None where it is not defined.
    """

    topics: ClassVar[tuple[str, ...]] = (*NUMBER_TOPICS, EVENTS_TOPIC)
    note: ClassVar[str] = ""

    def __init__(self, function: Callable[[RunView], float | None]) -> None:
        self._function, self._name = function, function.__name__
        self.title = self._name.replace("_", " ")

    def quantities(self, signals: Signals) -> tuple[Quantity, ...]:
        """Return its one number."""
        note = (self._function.__doc__ or "").strip().partition("\n")[0]
        return (Quantity(name=self._name, title=self.title, note=note, per_output=False),)

    def of(self, view: RunView) -> dict[str, float | None]:
        """Return its number for one run.

        Raises:
            HilError: it failed, or what it returned is no number.
        """
        try:
            value = self._function(view)
            found = None if value is None else float(value)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # whatever a user's function does
            raise HilError(f"metric {self._name}: {words(error)}") from error
        return {self._name: found if found is None or math.isfinite(found) else None}


def stated_by(measure: Measure, signals: Signals) -> tuple[Quantity, ...]:
    """Return what a measure says that it measures.

    Raises:
        AssertionError: it says nothing of the kind, in the words of its author.
    """
    for what, said in (("title", measure.title), ("note", measure.note)):
        if not isinstance(said, str):
            raise AssertionError(f"{what} is {said!r:.80}, expected text")
    stated: tuple[Quantity, ...] = asked("quantities(signals)", lambda: tuple(measure.quantities(signals)))
    for quantity in stated:
        try:
            convert(asdict(quantity), Quantity)
        except (TypeError, ValidationError) as error:
            said = f"quantities(signals) gave {quantity!r:.80}, expected hil.measure.Quantity objects: {error}"
            raise AssertionError(said) from error
    return stated


def quantities_of(measures: Sequence[Measure], signals: Signals) -> tuple[Quantity, ...]:
    """Return what some measures measure over these signals.

    Raises:
        HilError: if two of them use one name, or one of the user's own states none.
    """
    found: tuple[Quantity, ...] = ()
    for measure in measures:
        with located(f"report.measures: {type(measure).__name__}", AssertionError):
            found += stated_by(measure, signals)
    names = [quantity.name for quantity in found]
    for name in names:
        if names.count(name) > 1:
            raise HilError(f"report.measures: two of them give a number called {name!r}")
    return found


def each_output(measures: Sequence[Measure], signals: Signals) -> tuple[Quantity, ...]:
    """Return what some measures measure of every output where several are tracked: ``sse.angle`` is that of one output.

    Which values are better is kept where outputs of several units have no number together.
    """
    several = signals.tracked_unit() is None
    return tuple(
        replace(q, name=f"{q.name}.{name}", title=f"{q.title} of {name.replace('_', ' ')}", better=q.better if several else "")
        for name in (signals.tracked if len(signals.tracked) > 1 else ())
        for q in quantities_of(measures, signals.only(name))
        if q.per_output
    )


def in_one_row(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """Return the numbers of a run without the table of its single outputs, whose numbers are called as in `each_output`.

    >>> in_one_row({"sse": None, "outputs": {"angle": {"sse": 2.0}}})
    {'sse': None, 'sse.angle': 2.0}
    """
    single = {f"{key}.{name}": v for name, numbers in metrics.get("outputs", {}).items() for key, v in numbers.items()}
    return {name: value for name, value in metrics.items() if name != "outputs"} | single


def measured(view: RunView, measures: Sequence[Measure], failed: dict[str, str] | None = None) -> dict[str, Any]:
    """Return the numbers of a run by name; `outputs` has those of single outputs, where more than one is tracked.

    Args:
        view: the run.
        measures: what measures it.
        failed: takes what a measure raised, by its title, whose numbers are None then; without it that is an error.

    Raises:
        HilError: a measure failed, in its author's words.
    """
    found: dict[str, Any] = {}
    for measure in measures:
        found |= _numbers(measure, view, failed)
    names = view.signals.tracked
    single = [measure for measure in measures if any(q.per_output for q in measure.quantities(view.signals))]
    if len(names) > 1 and single:
        found["outputs"] = {name: {} for name in names}
        for name in names:
            alone = view.only(name)
            for measure in single:
                keep = {q.name for q in measure.quantities(alone.signals) if q.per_output}
                found["outputs"][name] |= {key: value for key, value in _numbers(measure, alone, failed).items() if key in keep}
    return found


def _numbers(measure: Measure, view: RunView, failed: dict[str, str] | None) -> Mapping[str, float | None]:
    try:
        return _as_promised(measure, view, dict(measure.of(view)))
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever a user's measure does
        message = str(error) if isinstance(error, HilError) else f"measure {type(measure).__name__}: {words(error)}"
        if failed is None:
            raise HilError(message) from error
        failed[measure.title] = message
        return {quantity.name: None for quantity in measure.quantities(view.signals)}


def _as_promised(measure: Measure, view: RunView, numbers: Mapping[str, float | None]) -> Mapping[str, float | None]:
    """Return the numbers of a measure, which may be others in a long run than in the short one in which it was checked.

    Raises:
        HilError: one that it names is missing, or is no number.
    """
    name = type(measure).__name__
    for quantity in measure.quantities(view.signals):
        if quantity.name not in numbers:
            gave = ", ".join(numbers) or "nothing"
            raise HilError(f"measure {name}: of(view) gave {gave}, and not {quantity.name!r}, which it names")
        value = numbers[quantity.name]
        if value is not None and not (isinstance(value, Real) and math.isfinite(value)):
            raise HilError(f"measure {name}: {quantity.name} is {value!r:.60}, expected a finite number or None")
    return numbers


T = TypeVar("T")


class Named(dict[str, T]):
    """A dictionary of numbers whose error names those that are there.

    Args:
        kind: what one of them is called in the message.
        numbers: by name.
    """

    def __init__(self, kind: str, numbers: dict[str, T]) -> None:
        super().__init__(numbers)
        self.kind = kind

    def __missing__(self, name: str) -> T:
        raise unknown_name(self.kind, name, self)
