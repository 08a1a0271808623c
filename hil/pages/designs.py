"""What questions beside a run are answered with, as pages: bounds on a CAN bus, the place on it, trade-offs of a design.

On the screen their words and tables stand alone: `hil.cli.page_text.print_page`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hil.measure.signals import with_unit
from hil.pages import Badge, BarGroup, Bars, Block, Cell, Figure, Section, Series, State, Table, Text
from hil.pages.html import can_id_text
from hil.pages.html.page import Page

if TYPE_CHECKING:
    from design.monte_carlo.confidence import Interval
    from hil.design_questions import Compromise
    from hil.design_questions.bus_analysis import BusAnalysis
    from hil.design_questions.loop_on_bus import Judged
    from hil.sweeps.trigger_cost import OpenPoint, TriggerPoint

STATES: dict[str, State] = {"certified": "good", "refused": "bad"}


def _certificate(state: str) -> Badge:
    return Badge(label=state, state=STATES.get(state, "neutral"))


def _met(in_time: bool) -> Badge:
    return Badge(label="yes", state="good") if in_time else Badge(label="no", state="bad")


def bus_page(found: BusAnalysis) -> Page:
    """Return the page of an analysed CAN bus: every message with its bound, its deadline, and what delays it."""
    late = sum(not each.in_time for each in found.messages)
    verdict = Badge(label="every message meets its deadline", state="good")
    if found.disturbed:
        verdict = Badge(label="no bound: the experiment disturbs its bus, and --errors says by how much at most", state="warning")
    elif late:
        verdict = Badge(label=f"{late} of {len(found.messages)} messages may miss their deadline", state="bad")
    names = [can_id_text(each.can_id, extended=each.extended) for each in found.messages]
    bars = Bars(
        title="Response times", categories=names, y_label="response", y_unit="ms",
        groups=(
            BarGroup(label="measured", values=[each.measured_ms or 0.0 for each in found.messages]),
            BarGroup(label="bound", values=[each.bound_ms or 0.0 for each in found.messages], hollow=True),
        ),
        note="By priority. A message without a bar of its bound has none.",
    )  # fmt: skip
    rows: list[list[Cell]] = [
        [
            name, each.name, each.length, each.frame_ms, each.period_ms, each.deadline_ms, each.bound_ms, each.measured_ms,
            _met(each.in_time), f"{len(each.delayed_by)}: {', '.join(each.delayed_by[-3:])}" if place else "-",
        ]
        for place, (name, each) in enumerate(zip(names, found.messages))
    ]  # fmt: skip
    columns = ["id", "name", "bytes", "frame ms", "period ms", "deadline ms", "bound ms", "measured ms"]
    table = Table(
        columns=[*columns, "met", "delayed by"], rows=rows, wide=True,
        note="Met: whether its deadline is. Delayed by: how many messages win over it, and the last three of them; beside these "
        "one frame of any other may be on the bus already. A message with a dash for its bound has none, or one that takes too "
        "long to compute.",
    )  # fmt: skip
    full = f"The messages need {100 * found.load:.1f} % of the bus: those of low priority are not sent, or ever later."
    rate = f"{found.bitrate:,} bit/s" + (f", data {found.dbitrate:,} bit/s" if found.dbitrate else "")
    return Page(
        f"CAN bus: {found.name}",
        [Section(title="Messages", blocks=(table, *((Text(text=full),) if found.load > 1 else ()), bars))],
        kicker="hilrig · CAN bus",
        subtitle="Worst-case response times after Davis, Burns, Bril and Lukkien 2007, for nodes that queue by priority, to the "
        f"end of EOF. They hold if {found.assumes}.",
        badges=[verdict],
        facts=[("rate", rate), ("load at most", f"{100 * found.load:.2f} %"), ("simulated", f"{found.simulated_s:g} s")],
    )


def can_priority_page(
    name: str, unit: str, seconds: float, judged: Sequence[Judged], free: Judged | None, best: Judged | None
) -> Page:  # fmt: skip
    """Return the page.

    Args:
        name: of the experiment.
        unit: of the squared error.
        seconds: length of each run.
        judged: the places, from the most urgent on.
        free: the one to take that leaves the other messages their identifiers; None where no run came to its end.
        best: the one to take where others may be moved.
    """
    above = np.array([each.place.above for each in judged], dtype=np.float64)

    def curve(label: str, values: Sequence[float | None]) -> Series:
        y = np.array([np.nan if value is None else value for value in values], dtype=np.float64)
        return Series(label=label, x=above, y=y, marked=True)

    cost = Figure(
        title="Squared error of a run", series=(curve("cost", [each.cost for each in judged]),), x_unit="",
        x_label="messages that win over it", y_label="squared error", y_unit=unit, sync=None,
    )  # fmt: skip
    bounds = Figure(
        title="Bounds of the response times", x_label="messages that win over it", x_unit="", y_label="bound", y_unit="ms",
        sync=None,
        series=(
            curve("sensor", [each.bounds_ms[0] for each in judged]), curve("control", [each.bounds_ms[1] for each in judged]),
        ),
    )  # fmt: skip
    rows: list[list[Cell]] = [
        [
            each.place.above, can_id_text(each.place.can_id), can_id_text(each.place.control_can_id), each.place.moved, each.cost,
            _certificate(each.state), *each.bounds_ms, _met(each.in_time),
        ]
        for each in judged
    ]  # fmt: skip
    columns = ["messages above", "sensor", "control", "others moved", with_unit("squared error", unit), "certificate"]
    table = Table(
        columns=[*columns, "sensor bound, ms", "control bound, ms", "in time"], rows=rows, wide=True,
        highlight=frozenset(i for i, each in enumerate(judged) if each in (free, best)),
        note="A dash: safety stopped the run, or there is no bound.",
    )  # fmt: skip
    blocks: list[Block] = [cost, bounds, table]
    if free is not None:
        blocks.append(Text(text=f"Take {_set_in(free)}: the least urgent place within 1 % of the least cost that leaves the "
                                "others their identifiers."))  # fmt: skip
    if best is not None and best is not free:
        blocks.append(Text(text=f"With {best.place.moved} messages moved up, {_set_in(best)} does better."))
    taken = free or best
    return Page(
        f"CAN identifiers: {name}",
        [Section(title="Cost over priority", blocks=tuple(blocks))],
        kicker="hilrig · CAN bus",
        subtitle="Each place of the loop's packets among the messages of the bus, run with the experiment's seed.",
        badges=[Badge(label="no place" if taken is None else _set_in(taken), state="bad" if taken is None else "good")],
        facts=[("places", str(len(judged))), ("length of each run", f"{seconds:g} s")],
    )


def _set_in(each: Judged) -> str:
    """Return the identifiers of a place, of every node, as `--set` takes them."""
    at = each.place.experiment
    ids = {f"network.nodes.{name}.can_id": node.can_id for name, node in at.network.nodes.items()}
    ids["links.control_can_id"] = at.links.control_can_id
    return ", ".join(f"{key}={value:#x}" for key, value in ids.items() if value is not None)


def norm_trade_off_page(name: str, found: Sequence[Compromise]) -> Page:
    """Return the page.

    Args:
        name: of the plant.
        found: the designs, from the H-infinity one on.
    """
    curve = Series(
        label="designs by (7.33)", x=np.array([each.hinf for each in found]), y=np.array([each.h2 for each in found]), marked=True
    )
    figure = Figure(
        title="H2 norm against H-infinity norm", series=(curve,), x_label="H-infinity norm", x_unit="", y_label="H2 norm",
        sync=None, note="left the H-infinity design, right the H2 design",
    )  # fmt: skip
    rows: list[list[Cell]] = [[each.weight, each.level, each.hinf, each.h2, _certificate(each.state)] for each in found]
    table = Table(columns=["weight", "level", "H-infinity norm", "H2 norm", "certificate"], rows=rows, wide=True)
    first, last = found[0], found[-1]
    costs = Text(
        text=f"The H-infinity design costs {first.h2 / last.h2 - 1.0:.2%} more in the H2 norm than the H2 design, which costs "
        f"{last.hinf / first.hinf - 1.0:.2%} more in the H-infinity norm."
    )
    return Page(
        f"Trade-off of the norms: {name}",
        [Section(title="Mixed designs", blocks=(figure, table, costs))],
        kicker="hilrig · design",
        subtitle="The smallest H2 norm for every level of the H-infinity norm, over the network.",
        facts=[("designs", str(len(found)))],
    )


def _half(interval: Interval) -> str:
    return f" ± {interval.half_width:.2g}" if interval.bounded else ""


def trigger_page(
    name: str, kind: str, units: tuple[str, str], points: Sequence[TriggerPoint], best: Sequence[TriggerPoint],
    open_points: Sequence[OpenPoint] = (),
) -> Page:  # fmt: skip
    """Return the page.

    Args:
        name: of the experiment.
        kind: of the trigger.
        units: of the gains, and of the squared error.
        points: thresholds with gains.
        best: those that no other certified one beats.
        open_points: those that the budget or an interrupt left undecided.
    """

    def marks(label: str, of: Sequence[TriggerPoint], line: bool = False) -> Series:
        ran = sorted((each for each in of if not each.stopped), key=lambda each: each.packets.value)
        x, y = (np.array(values) for values in ([each.packets.value for each in ran], [each.cost.value for each in ran]))
        return Series(label=label, x=x, y=y, style="line" if line else "circles", marked=line)

    sure = [each for each in points if each.state == "certified"]
    groups = (
        marks("best certified", best, line=True),
        marks("certified, gain for no trigger", [each for each in sure if not each.of.share]),
        marks("certified, gain for the trigger", [each for each in sure if each.of.share]),
        marks("not certified", [each for each in points if each.state != "certified"]),
    )
    figure = Figure(
        title="Squared error against packets", series=tuple(each for each in groups if len(each.x)), x_label="sensor packets",
        x_unit="1/s", y_label="squared error", y_unit=units[1], x_log=True, y_log=True, sync=None, height_px=320,
        note="means over the runs",
    )  # fmt: skip
    relative, runs = kind == "relative", points[0].packets.n
    rows: list[list[Cell]] = [
        [
            f"{each.of.threshold:g}" if each.of.threshold else "every slot", "  ".join(f"{v:.4g}" for v in each.of.gain.ravel()),
            f"{each.of.share:.0%} wrong" if each.of.share else "no trigger",
            f"{each.stopped} runs stopped" if each.stopped else f"{each.cost.value:.4g}" + _half(each.cost),
            f"{each.packets.value:.3g}" + _half(each.packets), _certificate(each.state),
            each.bound if relative else ", ".join(f"{output} {value:.3g}" for output, value in each.ends_within.items()) or "-",
        ]
        for each in points
    ]  # fmt: skip
    columns = ["threshold", f"gain, {units[0]}", "designed for", with_unit("squared error", units[1]), "packets/s", "certificate"]
    table = Table(
        columns=[*columns, "H2 norm at most" if relative else "ends within (rms)"], rows=rows, wide=True,
        highlight=frozenset(i for i, each in enumerate(points) if each in best),
        note=f"± half of a 95 % interval over {runs} runs. Set apart: the {len(best)} certified points that no other certified "
        "one beats in both numbers.",
    )  # fmt: skip
    return Page(
        f"Event trigger: {name}",
        [Section(title="Threshold and gain", blocks=(figure, table, *(Text(text=f"Undecided: {left}") for left in open_points)))],
        kicker="hilrig · design",
        subtitle=f"A {kind} trigger: every threshold with the gain for no trigger, and with gains that know its error.",
        facts=[("points", str(len(points))), ("runs of each", str(runs))],
    )
