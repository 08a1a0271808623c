"""What `hil design` answers beside gains that are solved.

In lines: over historical data, without a network, over a measured one. By many designs or runs, as one table and one page:
``--can-id``, ``--trade-off``, ``--trigger``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import click
from msgspec.structs import replace

from design.errors import FieldError
from design.requests.tracking import LocalDesigned
from hil.certify.send_all_loop import judge_linear_law
from hil.cli.page_text import show_page
from hil.cli.terminal import Working, answer, print_facts
from hil.compose import compose
from hil.design_questions import TrackingTarget, compromises, digest_of_law, model_at, motion_at, on_plant
from hil.errors import HilError, exit_status, located
from hil.experiment import Experiment, load_experiment
from hil.experiment.tables import Timing
from hil.pages.designs import can_priority_page, norm_trade_off_page, trigger_page
from hil.plugins.registry import names
from plants import Signal

if TYPE_CHECKING:
    from design.controllers.sensor_nodes import Uses
    from design.tracking.synthesis import Design
    from hil.design_questions.loop_on_bus import Judged, Place
    from hil.design_questions.measured_network import Measured
    from hil.sweeps.trigger_cost import TriggerPoint


@runtime_checkable
class OverHistory(Protocol):
    """A controller, or the request for one, that says which of the samples its gains use.

    It is what ``hil design EXPERIMENT`` judges over historical data: what its gains cost, and how far that is from the best
    possible.
    """

    uses: Uses


def experiment_over_history(subject: str) -> Experiment | None:
    """Return the experiment of a name with several sensor nodes, or with gains over historical data; None for any other name."""
    from hil.rig import rig_of

    if subject in names("hil.plants") or ":" in subject:
        return None
    experiment = load_experiment(subject)
    return experiment if len(rig_of(experiment).sensors) > 1 or isinstance(experiment.controller, OverHistory) else None


def show_historical(experiment: Experiment, orders: bool, spread: bool) -> None:
    """Print what gains over historical data cost."""
    from hil.certify.historical_loop import judge_historical

    with located(experiment.name, ValueError), Working(f"{experiment.name}: what its gains cost"):
        found = judge_historical(compose(experiment), orders=orders, spread=spread)
    unit = gain_unit(experiment.plant.inputs, experiment.plant.states)
    answer(found, lambda: print(*historical_lines(found, unit), sep="\n"))


def gain_unit(inputs: Sequence[Signal], of: Sequence[Signal]) -> str:
    """Return the unit of gains from signals to inputs, in words.

    >>> from plants import DCMotor
    >>> gain_unit(DCMotor().inputs, DCMotor().states)
    'V per rad, rad/s'
    """
    return " per ".join(", ".join(dict.fromkeys(signal.unit for signal in signals)) for signals in (inputs, of))


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


def design_local(target: TrackingTarget, request: LocalDesigned) -> dict[str, Any]:
    """Return a local design as plain data: its matrices, its norms without a network, the verdict over the network.

    It is what ``hil design PLANT|EXPERIMENT --local`` answers: a design for the plant alone, certified over the network.

    Raises:
        HilError: no such design.
    """
    from design.processes.delay_chain import DelayChain

    try:
        law = request.law(model_at(target))
    except FieldError as error:
        raise HilError(f"--{error.field.replace('_', '-')}: {error.message}") from error
    none = DelayChain(transition=((1.0,),))
    rho = request.input_weight
    alone = judge_linear_law(model_at(target), none, none, law, input_weight=rho).to_json()
    over_network = judge_linear_law(
        motion_at(target), target.sc, target.ca, law, input_weight=rho, digest=digest_of_law(target, law)
    )  # fmt: skip
    verdict = on_plant(target, over_network)
    return {
        "plant": target.plant,
        "period_s": target.period_s,
        "local": request.method,
        "input_weight": rho,
        "noise": request.noise,
        "law": {"A": law.A.tolist(), "B": law.B.tolist(), "C": law.C.tolist(), "D": law.D.tolist()},
        "without_network": {"h2": alone["h2_norm"], "hinf": alone["hinf_norm"], "radius": alone["number"]},
        "verdict": verdict.to_json(),
    }


def show_local(document: dict[str, Any]) -> None:
    """Print a local design."""
    alone, verdict = document["without_network"], document["verdict"]
    click.echo(f"{document['plant']}, {document['local']} by python-control, period {document['period_s']:g} s")
    print_facts((
        ("H2 norm", f"{alone['h2']:.6g}", "of z = [C x; rho u], without a network"),
        ("H-infinity norm", f"{alone['hinf']:.6g}", "without a network"),
        ("second-moment radius", f"{alone['radius']:.6f}", "without a network"),
        ("over the network", verdict["state"], verdict["reason"]),
        ("in an experiment", "", f'[controller] kind = "local-designed", method = "{document["local"]}"'),
    ))  # fmt: skip


def measured_ways(path: Path, period_s: float) -> tuple[Measured, Measured, tuple[str, ...]]:
    """Return both directions of a measured link, the law of each fitted to its packets, and what was done about clocks.

    It is what ``hil design PLANT --network LOG`` designs for. Fitting alone loads scipy.stats, half a second of CPU.

    Args:
        path: a log of `hil probe`, or of a run.
        period_s: length of a slot, s.

    Raises:
        HilError: the log has one direction, or a direction that no law explains.
    """
    from hil.design_questions.measured_network import measured
    from hil.log.recordings import BACK, THERE, packet_records
    from hil.log.recordings.read import read_recording
    from transport.errors import FieldError
    from transport.law_fit import fit_law

    records, notes = packet_records(read_recording([path]))
    if THERE not in records or BACK not in records:
        said = f"holds {' and '.join(records)}; a design needs both directions, as `hil probe` measures them"
        raise HilError(f"--network {path}: {said}")
    found = {}
    for way, record in records.items():
        with located(f"--network {path}: {way}", HilError, FieldError):
            found[way] = measured(fit_law(record, period_s, Timing().deadline * period_s), holds_input=way == BACK)
    return found[THERE], found[BACK], notes


def network_document(
    target: TrackingTarget, design: Design, sc: Measured, ca: Measured, notes: tuple[str, ...]
) -> dict[str, Any]:
    """Return the laws of a measured network, and the verdict over all that the measurement leaves possible, as plain values."""
    from hil.design_questions.measured_network import region_verdict

    ways = {
        name: {"class": way.fit.law_class, "packets": len(way.fit.record.sent_s), "law": way.fit.spec, "max_age": way.at.max_age}
        for name, way in (("sc", sc), ("ca", ca))
    }
    return {**ways, "notes": list(notes), "region": region_verdict(target, design, sc, ca).to_json()}


def network_lines(said: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Return what a document says of the measured network, line by line: name, value, remark."""
    lines = [(f"network, {way}", said[way]["class"], f"{said[way]['packets']} packets") for way in ("sc", "ca")]
    return [*lines, ("over all it leaves", said["region"]["state"], said["region"]["reason"])]


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
    unit = gain_unit(asked.target.of.inputs, asked.target.of.outputs)
    show_page(trigger_page(subject, asked.kind, unit, points, best, open_points), document, path)
    if status:
        print(f"hil: design interrupted after {len(points)} of {len(plan)} points", file=sys.stderr)
        sys.exit(status)
