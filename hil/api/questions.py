"""What a program asks without a run: gains for a plant, the network laws of an experiment, a chapter of the thesis."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hil.api.experiment_source import Source, checked_experiment
from hil.errors import HilError
from hil.runtime.time.clock import monotonic_ns

if TYPE_CHECKING:
    from hil.api.design_result import DesignResult
    from hil.api.laws_result import Laws
    from hil.reproduce import Reproduction


def design(source: str, *, period: float | None = None, sojourns: int = 1, **options: Any) -> DesignResult:
    """Design gains for a plant over the network (7.34), or for the plant and network of an experiment.

    Args:
        source: name of a plant plug-in or of an experiment.
        period: sample period in s; the thesis's, or the experiment's, by default.
        sojourns: slots for which tau has lasted that a gain distinguishes, over semi-Markov delays.
        options: of `design.TrackingProblem`: objective ("h2", "hinf", "mixed"), information, R, samples, ...

    Returns:
        the design: ``gains``, ``certificate``, ``verdict``, ``problem``; ``save("gains.json")`` writes what an experiment takes.

    Raises:
        HilError: an option that does not fit, or no gains meet the request.
    """
    from design.errors import DesignError
    from design.requests.tracking import solve_tracking
    from hil.api.design_result import DesignResult
    from hil.design_questions.design_problem import problem_for, tracking_target

    target = tracking_target(source, period, sojourns)
    begun = monotonic_ns()
    try:
        found = solve_tracking(problem_for(target, **options))
    except (DesignError, TypeError) as error:
        raise HilError(f"design: {error}") from error
    return DesignResult(target=target, design=found, wall_s=round((monotonic_ns() - begun) / 1e9, 3))


def laws(source: Source, **changes: Any) -> Laws:
    """Return what an experiment's network laws do in the long run, before anything runs.

    Args:
        source: as in `run`.
        changes: path to value, as in `load_experiment`.

    Returns:
        "sc" or each sensor node, and "ca", to its stationary law, mean bursts, ages and losses (`LawAnalysis`).

    Raises:
        HilError: if the experiment cannot be read.
    """
    from hil.api.laws_result import Laws
    from hil.compose.law_files import with_law_files
    from hil.rig.normal_form import rig_of
    from transport.law_tests.analysis import analyse_law

    checked = with_law_files(checked_experiment(source, None, None, changes))
    period_s = float(checked.period)
    rig = rig_of(checked)
    named = {sensor.name if len(rig.sensors) > 1 else "sc": sensor.law for sensor in rig.sensors} | {"ca": rig.ca_law}
    found = {name: analyse_law(law, period_s, checked.timing.deadline * period_s) for name, law in named.items()}
    return Laws(checked.name, found, period_s)


def reproduce_chapter(chapter: str) -> Reproduction:
    """Compute every number of a chapter of the thesis and judge it beside the printed one.

    Args:
        chapter: "ch2" to "ch7"; some take minutes.

    Returns:
        ``rows`` with their verdicts, ``counts`` of them, ``figures``.

    Raises:
        HilError: no such chapter.
    """
    from hil.measure.names import unknown_name
    from hil.reproduce import chapters, reproduce

    if chapter not in chapters():
        raise unknown_name("chapter", chapter, chapters())
    return reproduce(chapter)
