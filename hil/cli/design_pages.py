"""What `hil design` answers by many designs or runs, as one table and one page: ``--can-id``, ``--trade-off``, ``--trigger``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace

from hil.cli.page_text import show_page
from hil.cli.terminal import Working
from hil.compose.loop import compose
from hil.design_questions.design_problem import TrackingTarget, compromises
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.pages.designs import can_priority_page, norm_trade_off_page, trigger_page
from hil.plugins.registry import names

if TYPE_CHECKING:
    from hil.design_questions.loop_on_bus import Judged, Place
    from hil.sweeps.trigger_cost import TriggerPoint

LONGEST_S = 10.0
"""What is run of an experiment for a place on its bus, s."""

SHAPES = frozenset({
    "subject", "trade_off", "information", "gain_bound", "input_weight", "z", "period", "samples", "sojourns",
    "row_sojourns", "integral", "starts", "seed", "path", "force", "as_json",
})  # fmt: skip
"""Options that mean something with ``--trade-off``."""


def show_can_id(subject: str, path: Path | None) -> None:
    """Run an experiment with its packets in every place: what the loop's place on its CAN bus costs, and which to take.

    Args:
        subject: an experiment.
        path: as of `hil.cli.page_text.show_page`.

    Raises:
        HilError: no CAN bus with time, recorded traffic, or a file that cannot be written.
    """
    from hil.design_questions.loop_on_bus import places_of, recommended
    from hil.experiment.table import Seconds

    experiment = load_experiment(subject, ("allow_uncertified=true",))
    seconds = min(float(experiment.duration), LONGEST_S)
    places, judged = places_of(replace(experiment, duration=Seconds(seconds))), []
    for i, place in enumerate(places):
        with Working(f"{experiment.name}, place {i + 1} of {len(places)}"):
            judged.append(_judge(place))
    free, best = recommended(judged, free=True), recommended(judged, free=False)
    document = {
        "experiment": experiment.name, "duration_s": seconds, "places": [_plain(each) for each in judged],
        "recommended": None if free is None else _plain(free), "with_others_moved": None if best is None else _plain(best),
    }  # fmt: skip
    show_page(can_priority_page(experiment.name, seconds, judged, free, best), document, path)


def _judge(place: Place) -> Judged:
    from hil.design_questions.loop_on_bus import Judged
    from hil.measure.summary import summarise
    from hil.measure.view import view_of
    from hil.rig.can_bus import CONTROLLER, analysed, can_bus_of, own_packets, rates_of
    from hil.runtime.virtual import simulate
    from transport.can_analysis import response_times

    loop = compose(place.experiment)
    bus = can_bus_of(loop.rig)
    assert bus is not None and loop.verdict is not None
    own = own_packets(loop.rig, bus, loop.rows)
    fd = bus.table.dbitrate is not None
    last = {packet.first + len(packet.sizes(fd=fd)) - 1: packet for packet in own}
    found = response_times(analysed(loop.rig, bus, loop.rows), rates_of(bus.table))
    own_bounds = [b for b in found if not (b.message.extended or bus.table.bit_error_rate) and b.message.identifier in last]
    bounds = {last[b.message.identifier].sender: b for b in own_bounds}
    ms = {name: None if b.response_ns is None else b.response_ns / 1e6 for name, b in bounds.items()}
    summary = summarise(view_of(simulate(loop, place.experiment.seed), loop.experiment, loop.rig))
    costs = [value for name, value in summary["metrics"].items() if name == "sse" or name.startswith("sse.")]
    stopped = bool(summary["safety"]) or not costs or any(value is None for value in costs)
    return Judged(
        place=place, cost=None if stopped else float(sum(costs)), state=loop.verdict.state,
        bounds_ms=(ms.get(own[0].sender), ms.get(CONTROLLER)), in_time=bool(bounds) and all(b.in_time for b in bounds.values()),
    )  # fmt: skip


def _plain(judged: Judged) -> dict[str, object]:
    return {
        "can_id": judged.place.can_id, "control_can_id": judged.place.control_can_id, "above": judged.place.above,
        "moved": judged.place.moved, "cost": judged.cost, "certificate": judged.state, "sensor_bound_ms": judged.bounds_ms[0],
        "control_bound_ms": judged.bounds_ms[1], "in_time": judged.in_time,
    }  # fmt: skip


def show_trade_off(target: TrackingTarget, options: dict[str, Any], path: Path | None) -> None:
    """Solve the designs of a curve: what a smaller H-infinity norm costs in the H2 norm.

    Args:
        target: plant and network.
        options: of the problem.
        path: as of `hil.cli.page_text.show_page`.

    Raises:
        HilError: no gains meet the request, or a file that cannot be written.
    """

    with Working(f"{target.plant} trade-off {options['information']}") as watch:
        found = compromises(target, watch, **options)
    document = {
        "plant": target.plant, "period_s": target.period_s, "information": options["information"],
        "designs": [each.to_json() for each in found],
    }  # fmt: skip
    show_page(norm_trade_off_page(target.plant, found), document, path)


def show_trigger(subject: str, input_weight: float | None, options: dict[str, Any], path: Path | None) -> None:
    """Design gains for every threshold of an event trigger, judge and run them: cost against packets.

    After Ctrl-C what was found until then is printed and written, with what is open; the exit status is 130.

    Args:
        subject: an experiment.
        input_weight: weight R of every input; None: the default.
        options: of the problem.
        path: as of `hil.cli.page_text.show_page`.

    Raises:
        HilError: no gains meet the request, an experiment that has no such question, or a file that cannot be written.
    """
    import numpy as np

    from hil.design_questions.trigger_gains import candidates, planned, trigger_question
    from hil.sweeps.trigger_cost import check_chains, front, run_candidate, undecided

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
    except KeyboardInterrupt as interrupt:
        status = getattr(interrupt, "status", 130)
        if not points:
            print("hil: design interrupted; nothing was found, nothing was written", file=sys.stderr)
            sys.exit(status)
    best, open_points = front(points), undecided(plan, points)
    document = {
        "experiment": subject, "period_s": asked.target.period_s, "trigger": asked.kind, "runs": points[0].packets.n,
        "interrupted": status != 0, "points": [each.to_json() | {"on_front": each in best} for each in points],
        "undecided": [each._asdict() for each in open_points],
    }  # fmt: skip
    show_page(trigger_page(subject, asked.kind, points, best, open_points), document, path)
    if status:
        print(f"hil: design interrupted after {len(points)} of {len(plan)} points", file=sys.stderr)
        sys.exit(status)
