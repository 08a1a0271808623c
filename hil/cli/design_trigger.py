"""``hil design --trigger``: threshold of an event trigger and gain together, cost against packets."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.cli.terminal import print_json
from hil.errors import HilError

if TYPE_CHECKING:
    from hil.sweeps.trigger_cost import OpenPoint, TriggerPoint


def show_trigger(
    subject: str, input_weight: float | None, options: dict[str, Any], path: Path | None, force: bool, as_json: bool
) -> None:
    """Design gains for every threshold, judge and run them; print the table, and write a page.

    After Ctrl-C what was found until then is printed and written, with what is open; the exit status is 130.

    Args:
        subject: an experiment.
        input_weight: weight R of every input; None: the default.
        options: of the problem.
        path: of the page; None: none is written.
        force: replace a file that is there.
        as_json: print JSON.

    Raises:
        HilError: no gains meet the request, an experiment that has no such question, or a file that cannot be written.
    """
    import numpy as np

    from design.errors import DesignError
    from hil.cli.terminal import Working
    from hil.design_questions.trigger_gains import candidates, planned, trigger_question
    from hil.files.outputs import check_page, write_output
    from hil.plugins.registry import names
    from hil.sweeps.trigger_cost import check_chains, front, run_candidate, undecided

    if path is not None:
        check_page(path, force=force)
    if subject in names("hil.plants"):
        raise HilError(f"{subject}: --trigger: name an experiment, whose runs say cost and packets, such as dc-motor-ours-h2")
    asked = trigger_question(subject)
    check_chains(asked)
    if input_weight is not None:
        options = options | {"R": np.full(asked.target.B.shape[1], input_weight)}
    plan, status = planned(asked), 0
    points: list[TriggerPoint] = []
    try:
        with Working(f"{subject}, gains and runs of triggers") as watch:
            for each in candidates(asked, watch, **options):
                watch.counted(len(points), len(plan))
                points.append(run_candidate(asked, each))
    except DesignError as error:
        raise HilError(f"design: {error}") from error
    except KeyboardInterrupt as interrupt:
        status = getattr(interrupt, "status", 130)
        if not points:
            print("hil: design interrupted; nothing was found, nothing was written", file=sys.stderr)
            sys.exit(status)
    best, open_points = front(points), undecided(plan, points)
    if path is not None:
        from hil.pages.designs import trigger_page

        write_output(path, trigger_page(subject, asked.kind, points, best, open_points))
    if as_json:
        print_json({
            "experiment": subject, "period_s": asked.target.period_s, "trigger": asked.kind, "runs": points[0].packets.n,
            "interrupted": status != 0, "points": [each.to_json() | {"on_front": each in best} for each in points],
            "undecided": [each._asdict() for each in open_points],
        })  # fmt: skip
    else:
        _print(subject, asked.kind, points, best, open_points)
    if status:
        print(f"hil: design interrupted after {len(points)} of {len(plan)} points", file=sys.stderr)
        sys.exit(status)


def _print(name: str, kind: str, points: list[TriggerPoint], best: list[TriggerPoint], open_points: list[OpenPoint]) -> None:
    from rich.markup import escape
    from rich.table import Table

    from hil.cli.terminal import print_table, visible

    said = f"{name}: cost over packets, {kind} trigger; ± half of a 95 % interval over {points[0].packets.n} runs"
    table = Table(title=escape(visible(said)))
    heads = ("threshold", "gain", "designed for", "squared error", "packets/s", "certificate")
    for head in (*heads, "H2 norm <=" if kind == "relative" else "ends within (rms)"):
        table.add_column(head, justify="right")
    for each in points:
        cost = f"{each.stopped} runs stopped" if each.stopped else f"{each.cost.value:.4g} ± {each.cost.half_width:.2g}"
        bound = "-" if each.bound is None else f"{each.bound:.4g}"
        ends = ", ".join(f"{output} {value:.3g}" for output, value in each.ends_within.items()) or "-"
        packets = f"{each.packets.value:.3g} ± {each.packets.half_width:.2g}"
        table.add_row(
            f"{each.of.threshold:g}" if each.of.threshold else "every slot", "  ".join(f"{v:.4g}" for v in each.of.gain.ravel()),
            f"{each.of.share:.0%} wrong" if each.of.share else "no trigger", cost, packets, each.state,
            bound if kind == "relative" else escape(visible(ends)),
            style="bold" if each in best else "" if each.state == "certified" else "red",
        )  # fmt: skip
    print_table(table)
    print(f"Bold: the {len(best)} certified points that no other certified one beats in both numbers. Red: not certified.")
    for left in open_points:
        print(f"Undecided: {left}")
