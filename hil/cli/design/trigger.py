"""``--trigger``: threshold of an event trigger and gain together, cost against packets (Section 8.2.2)."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.design_question import Question, gain_unit, weight_of
from hil.cli.page_text import show_page
from hil.cli.terminal import Working
from hil.errors import HilError, exit_status

if TYPE_CHECKING:
    from hil.sweeps.trigger_cost import TriggerPoint


def answer(
    subject: str, path: Path | None, gain_bound: float | None, input_weight: float | None, starts: int, seed: int
) -> None:  # fmt: skip
    """Design gains for every threshold of an event trigger, judge and run them.

    After Ctrl-C what was found until then is printed and written, with what is open; the exit status is 130.

    Raises:
        HilError: no gains meet the request, an experiment that has no such question, or a file that cannot be written.
    """
    from hil.design_questions.trigger_gains import candidates, planned, trigger_question
    from hil.measure.signals import signals_of
    from hil.measure.tracking import squared_unit
    from hil.pages.designs import trigger_page
    from hil.plugins.registry import names
    from hil.sweeps.trigger_cost import check_chains, front, run_candidate, undecided

    if subject in names("hil.plants"):
        raise HilError(f"{subject}: --trigger: name an experiment, whose runs say cost and packets, such as dc-motor-ours-h2")
    asked = trigger_question(subject)
    check_chains(asked)
    R = weight_of(asked.target, input_weight)
    plan, status = planned(asked), 0
    points: list[TriggerPoint] = []
    try:
        with Working(f"{subject}, gains and runs of triggers") as watch:
            for each in candidates(asked, watch, gain_bound=gain_bound, R=R, starts=starts, seed=seed):
                watch.counted(len(points), len(plan))
                points.append(run_candidate(asked, each))
    except KeyboardInterrupt as interrupt:
        status = exit_status(interrupt)
        if not points:
            print("hil: design interrupted; nothing was found, nothing was written", file=sys.stderr)
            sys.exit(status)
    best, open_points = front(points), undecided(plan, points)
    document = {
        "experiment": subject, "period_s": asked.target.period_s, "trigger": asked.kind, "runs": points[0].packets.n,
        "interrupted": status != 0, "points": [each.to_json() | {"on_front": each in best} for each in points],
        "undecided": [each._asdict() for each in open_points],
    }  # fmt: skip
    plant = asked.target.of
    units = gain_unit(plant.inputs, plant.outputs), squared_unit(signals_of(plant))
    show_page(trigger_page(subject, asked.kind, units, points, best, open_points), document, path)
    if status:
        print(f"hil: design interrupted after {len(points)} of {len(plan)} points", file=sys.stderr)
        sys.exit(status)


QUESTION = Question(
    20, lambda options: options["trigger"],
    [click.Option(["--trigger"], is_flag=True,
                  help="Threshold of the sensor node's trigger and gain: cost over packets; -o: a page.")],
    answer, "--trigger, whose gains are H2 gains that use no ages: a silent node sends none",
)  # fmt: skip
