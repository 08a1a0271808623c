"""``hil design --can-id``: what the loop's place among the identifiers on its CAN bus costs, and which to take."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace

from hil.cli.terminal import print_json

if TYPE_CHECKING:
    from hil.design_questions.can_priority import Judged, Place

LONGEST_S = 10.0
"""What is run of an experiment, s."""


def show_can_id(subject: str, path: Path | None, force: bool, as_json: bool) -> None:
    """Run an experiment with its packets in every place; print the table, and write a page.

    Args:
        subject: an experiment.
        path: of the page; None: none is written.
        force: replace a file that is there.
        as_json: print JSON.

    Raises:
        HilError: no CAN bus with time, recorded traffic, or a file that cannot be written.
    """
    from hil.cli.terminal import Working
    from hil.design_questions.can_priority import places_of, recommended
    from hil.experiment import load_experiment
    from hil.experiment.table import Seconds
    from hil.files.outputs import check_page, write_output

    if path is not None:
        check_page(path, force=force)
    experiment = load_experiment(subject, ("allow_uncertified=true",))
    experiment = replace(experiment, duration=Seconds(min(float(experiment.duration), LONGEST_S)))
    places, judged = places_of(experiment), []
    for i, place in enumerate(places):
        with Working(f"{experiment.name}, place {i + 1} of {len(places)}"):
            judged.append(_judge(place))
    free, best = recommended(judged, free=True), recommended(judged, free=False)
    if path is not None:
        from hil.pages.designs import can_priority_page

        write_output(path, can_priority_page(experiment.name, judged, free or best))
    if as_json:
        print_json({
            "experiment": experiment.name, "duration_s": float(experiment.duration), "places": [_plain(each) for each in judged],
            "recommended": None if free is None else _plain(free), "with_others_moved": None if best is None else _plain(best),
        })  # fmt: skip
        return
    _print(experiment.name, float(experiment.duration), judged, free, best)


def _judge(place: Place) -> Judged:
    from hil.compose.loop import compose
    from hil.design_questions.can_priority import Judged
    from hil.measure.summary import summarise
    from hil.measure.view import view_of
    from hil.rig.can_bus import CONTROLLER, analysed, can_bus_of, own_packets, rates_of
    from hil.runtime.simulated import simulate
    from transport.can_analysis import response_times

    loop = compose(place.experiment)
    bus = can_bus_of(loop.rig)
    assert bus is not None and loop.verdict is not None
    own = own_packets(loop.rig, bus, loop.rows)
    fd = bus.table.dbitrate is not None
    last = {packet.first + len(packet.sizes(fd=fd)) - 1: packet for packet in own}
    found = response_times(analysed(loop.rig, bus, loop.rows), rates_of(bus.table))
    bounds = {last[b.message.identifier].sender: b for b in found if not b.message.extended and b.message.identifier in last}
    if bus.table.bit_error_rate:
        bounds = {}
    ms = {name: None if b.response_ns is None else b.response_ns / 1e6 for name, b in bounds.items()}
    summary = summarise(view_of(simulate(loop, place.experiment.seed), loop.experiment, loop.rig))
    costs = [value for name, value in summary["metrics"].items() if name == "sse" or name.startswith("sse.")]
    stopped = bool(summary["safety"]) or not costs or any(value is None for value in costs)
    return Judged(
        place=place, cost=None if stopped else float(sum(costs)), state=loop.verdict.state,
        bounds_ms=(ms.get(own[0].sender), ms.get(CONTROLLER)), in_time=bool(bounds) and all(b.in_time for b in bounds.values()),
    )  # fmt: skip


def _plain(each: Judged) -> dict[str, object]:
    return {
        "can_id": each.place.can_id, "control_can_id": each.place.control_can_id, "above": each.place.above,
        "moved": each.place.moved, "cost": each.cost, "certificate": each.state, "sensor_bound_ms": each.bounds_ms[0],
        "control_bound_ms": each.bounds_ms[1], "in_time": each.in_time,
    }  # fmt: skip


def _print(name: str, seconds: float, judged: list[Judged], free: Judged | None, best: Judged | None) -> None:
    from rich.markup import escape
    from rich.table import Table

    from hil.cli.terminal import print_table, visible

    table = Table(title=escape(visible(f"{name}: cost over the place of its packets, {seconds:g} s each")))
    for head in ("place", "sensor", "control", "others moved", "squared error", "certificate", "sensor bound", "control bound"):
        table.add_column(head, justify="right")
    for each in judged:
        bounds = ["none" if bound is None else f"{bound:.3f} ms" for bound in each.bounds_ms]
        cost = "stopped" if each.cost is None else f"{each.cost:.5g}"
        style = "bold" if each in (free, best) else "" if each.in_time else "red"
        table.add_row(
            f"below {each.place.above}", f"{each.place.can_id:03X}", f"{each.place.control_can_id:03X}", str(each.place.moved),
            cost, each.state, *bounds, style=style,
        )  # fmt: skip
    print_table(table)
    if free is not None:
        print(f"Take {said(free)}: the least urgent place within 1 % of the least cost that leaves the others their identifiers.")
    if best is not None and best is not free:
        print(f"With {best.place.moved} messages moved up, {said(best)} does better.")


def said(each: Judged) -> str:
    """Return the identifiers of a place as an experiment sets them."""
    return f"can_id = {each.place.can_id:#x}, links.control_can_id = {each.place.control_can_id:#x}"
