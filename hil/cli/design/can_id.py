"""``--can-id``: what the place of a loop's packets on its CAN bus costs, and which identifiers to take."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.design_question import Question
from hil.cli.page_text import show_page
from hil.cli.terminal import Working

if TYPE_CHECKING:
    from hil.design_questions.loop_on_bus import Judged, Place

LONGEST_S = 10.0
"""What is run of an experiment for a place on its bus, s."""


def answer(subject: str, path: Path | None) -> None:
    """Run an experiment with its packets in every place: what the loop's place on its CAN bus costs, and which to take.

    Raises:
        HilError: no CAN bus with time, recorded traffic, or a file that cannot be written.
    """
    from msgspec.structs import replace

    from hil.design_questions.loop_on_bus import places_of, recommended
    from hil.experiment import load_experiment
    from hil.experiment.table import Seconds
    from hil.pages.designs import can_priority_page

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
    from hil.compose import compose
    from hil.design_questions.loop_on_bus import Judged
    from hil.measure.summary import summarise
    from hil.measure.view import view_of
    from hil.rig.can_bus import CONTROLLER, analysed, can_bus_of, is_disturbed, own_packets, rates_of
    from hil.runtime.virtual import simulate
    from transport.can_analysis import response_times

    loop = compose(place.experiment)
    bus = can_bus_of(loop.rig)
    assert bus is not None and loop.verdict is not None
    own = own_packets(loop.rig, bus, loop.rows)
    fd = bus.table.dbitrate is not None
    last = {packet.first + len(packet.sizes(fd=fd)) - 1: packet for packet in own}
    found = response_times(analysed(loop.rig, bus, loop.rows), rates_of(bus.table))
    disturbed = is_disturbed(bus.table, loop.experiment.fault)
    own_bounds = [b for b in found if not (b.message.extended or disturbed) and b.message.identifier in last]
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


QUESTION = Question(
    10, lambda options: options["can_id"],
    [click.Option(["--can-id"], is_flag=True,
                  help="Which CAN identifiers to take: cost over their place on the bus; -o: a page.")],
    answer, "--can-id, which runs the controller as it is",
)  # fmt: skip
