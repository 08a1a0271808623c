"""Questions about an experiment and its runs: gains over historical data, ``--trigger``, ``--can-id``."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import click

from hil.cli.design_question import Question, gain_unit, weight_of
from hil.cli.page_text import show_page
from hil.cli.terminal import Working
from hil.cli.terminal import answer as print_answer
from hil.errors import HilError, exit_status, located

if TYPE_CHECKING:
    from design.controllers.sensor_nodes import Uses
    from hil.design_questions.loop_on_bus import Judged, Place
    from hil.sweeps.trigger_cost import TriggerPoint


@runtime_checkable
class OverHistory(Protocol):
    """A controller, or the request for one, that says which of the samples its gains use."""

    uses: Uses


def is_over_history(options: Mapping[str, Any]) -> bool:
    """Return whether the subject is an experiment with several sensor nodes, or with gains over historical data."""
    from hil.experiment import load_experiment
    from hil.plugins.registry import names
    from hil.rig import rig_of

    subject = options["subject"]
    if subject in names("hil.plants") or ":" in subject:
        return False
    experiment = load_experiment(subject)
    return len(rig_of(experiment).sensors) > 1 or isinstance(experiment.controller, OverHistory)


def answer_historical(subject: str, orders: bool, spread: bool) -> None:
    """Print what gains over historical data cost."""
    from hil.certify.historical_loop import judge_historical
    from hil.compose import compose
    from hil.experiment import load_experiment

    experiment = load_experiment(subject)
    with located(experiment.name, ValueError), Working(f"{experiment.name}: what its gains cost"):
        found = judge_historical(compose(experiment), orders=orders, spread=spread)
    unit = gain_unit(experiment.plant.inputs, experiment.plant.states)
    print_answer(found, lambda: print(*historical_lines(found, unit), sep="\n"))


def historical_lines(found: dict[str, Any], unit: str) -> list[str]:
    """Return a judgement as lines for people.

    Args:
        found: as `judge_historical` returns it.
        unit: of the gains.
    """
    said = [f"{found['experiment']}, uses {found['uses']}", f"cost from the plant's start   {found['cost']:.6g}"]
    if "cost_sd" in found:
        said.append(f"  standard deviation of runs  {found['cost_sd']:.6g}")
    said.append(f"mean cost, x(0) ~ N(0, I)     {found['mean_cost']:.6g}")
    if found["bound_causal"] is None:
        said.append("bound, any causal controller  undecided: which node's packet arrives is not a Markov chain of its own")
    else:
        said.append(f"bound, any causal controller  {found['bound_causal']:.6g} (ours is {100 * found['gap']:.2f} % above)")
    said.append(f"bound, full state             {found['bound_full_state']:.6g}")
    said += [f"order {', '.join(each['nodes'])}: mean cost {each['mean_cost']:.6g}" for each in found.get("orders", ())]
    said.append(f"gains [phase][j] in {unit}, of x(k - j):")
    for i, phase in enumerate(found["gains"]):
        for j, rows in enumerate(phase):
            said += [f"  [{i}][{j}] " + " ".join(f"{entry:10.5g}" for entry in row) for row in rows]
    return said


def answer_trigger(
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


LONGEST_S = 10.0
"""What is run of an experiment for a place on its bus, s."""


def answer_can_id(subject: str, path: Path | None) -> None:
    """Run an experiment with its packets in every place: what the loop's place on its CAN bus costs, and which to take.

    Raises:
        HilError: no CAN bus with time, recorded traffic, outputs of several units, or a file that cannot be written.
    """
    from msgspec.structs import replace

    from hil.design_questions.loop_on_bus import places_of, recommended
    from hil.experiment import load_experiment
    from hil.experiment.table import Seconds
    from hil.measure.signals import signals_of
    from hil.measure.tracking import squared_unit, without_sense
    from hil.pages.designs import can_priority_page

    experiment = load_experiment(subject, ("allow_uncertified=true", 'report.measures=["tracking"]'))
    if "sse" in without_sense(signals_of(experiment.plant)):
        raise HilError(f"{experiment.name}: --can-id: its outputs have several units, so that their squared errors have no sum")
    seconds = min(float(experiment.duration), LONGEST_S)
    places, judged = places_of(replace(experiment, duration=Seconds(seconds))), []
    for i, place in enumerate(places):
        with Working(f"{experiment.name}, place {i + 1} of {len(places)}"):
            judged.append(_judge_place(place))
    free, best = recommended(judged, free=True), recommended(judged, free=False)
    document = {
        "experiment": experiment.name, "duration_s": seconds, "places": [_plain(each) for each in judged],
        "recommended": None if free is None else _plain(free), "with_others_moved": None if best is None else _plain(best),
    }  # fmt: skip
    unit = squared_unit(signals_of(experiment.plant))
    show_page(can_priority_page(experiment.name, unit, seconds, judged, free, best), document, path)


def _judge_place(place: Place) -> Judged:
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
    return Judged(
        place=place, cost=None if summary["safety"] else summary["metrics"]["sse"], state=loop.verdict.state,
        bounds_ms=(ms.get(own[0].sender), ms.get(CONTROLLER)), in_time=bool(bounds) and all(b.in_time for b in bounds.values()),
    )  # fmt: skip


def _plain(judged: Judged) -> dict[str, object]:
    return {
        "can_id": judged.place.can_id, "control_can_id": judged.place.control_can_id, "above": judged.place.above,
        "moved": judged.place.moved, "cost": judged.cost, "certificate": judged.state, "sensor_bound_ms": judged.bounds_ms[0],
        "control_bound_ms": judged.bounds_ms[1], "in_time": judged.in_time,
    }  # fmt: skip


QUESTIONS = (
    Question(
        30, is_over_history,
        [click.Option(["--orders"], is_flag=True, help="Gains over historical data: try every order of the nodes' turns."),
         click.Option(["--spread"], is_flag=True,
                      help="Gains over historical data: the standard deviation of the cost over runs, too.")],
        answer_historical, "gains over historical data, which [controller] asks for",
    ),
    Question(
        20, lambda options: options["trigger"],
        [click.Option(["--trigger"], is_flag=True,
                      help="Threshold of the sensor node's trigger and gain: cost over packets; -o: a page.")],
        answer_trigger, "--trigger, whose gains are H2 gains that use no ages: a silent node sends none",
    ),
    Question(
        10, lambda options: options["can_id"],
        [click.Option(["--can-id"], is_flag=True,
                      help="Which CAN identifiers to take: cost over their place on the bus; -o: a page.")],
        answer_can_id, "--can-id, which runs the controller as it is",
    ),
)  # fmt: skip
