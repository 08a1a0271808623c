"""Pages of `hil design`: cost over the place on a CAN bus, H2 against H-infinity norm, cost against packets of a trigger."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.design_questions.can_priority import Judged
from hil.design_questions.norm_trade_off import Compromise
from hil.pages.html.figures import Badge, Cell, Figure, Section, Series, State, Table
from hil.pages.html.page import render_page
from hil.sweeps.trigger_cost import OpenPoint, TriggerPoint

STATES: dict[str, State] = {"certified": "good", "refused": "bad"}


def can_priority_page(name: str, judged: Sequence[Judged], taken: Judged | None) -> str:
    """Return the page.

    Args:
        name: of the experiment.
        judged: the places, from the most urgent on.
        taken: the one to take; None where no run came to its end.
    """
    above = np.array([each.place.above for each in judged], dtype=np.float64)

    def curve(label: str, values: Sequence[float | None]) -> Series:
        y = np.array([np.nan if value is None else value for value in values], dtype=np.float64)
        return Series(label=label, x=above, y=y, marked=True)

    cost = Figure(
        title="Squared error of a run", series=(curve("cost", [each.cost for each in judged]),), x_unit="",
        x_label="messages that win over it", y_label="squared error", sync=None,
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
            each.place.above, f"{each.place.can_id:03X}", f"{each.place.control_can_id:03X}", each.place.moved, each.cost,
            Badge(label=each.state, state=STATES.get(each.state, "neutral")),
            each.bounds_ms[0], each.bounds_ms[1],
        ]
        for each in judged
    ]  # fmt: skip
    columns = ["messages above", "sensor", "control", "others moved", "cost", "certificate"]
    columns += ["sensor bound, ms", "control bound, ms"]
    said = "no place" if taken is None else f"can_id {taken.place.can_id:#x}, control_can_id {taken.place.control_can_id:#x}"
    return render_page(
        f"CAN identifiers: {name}",
        [Section(title="Cost over priority", blocks=(cost, bounds, Table(columns=columns, rows=rows, wide=True)))],
        kicker="hilrig · CAN bus",
        subtitle="Each place of the loop's packets among the messages of the bus, run with the experiment's seed.",
        badges=[Badge(label=said, state="good" if taken is not None else "bad")],
        facts=[("places", str(len(judged)))],
    )  # fmt: skip


def norm_trade_off_page(name: str, found: Sequence[Compromise]) -> str:
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
    rows: list[list[Cell]] = [[each.weight, each.level, each.hinf, each.h2, each.state] for each in found]
    table = Table(columns=["weight", "level", "H-infinity norm", "H2 norm", "certificate"], rows=rows, wide=True)
    return render_page(
        f"Trade-off of the norms: {name}",
        [Section(title="Mixed designs", blocks=(figure, table))],
        kicker="hilrig · design",
        subtitle="The smallest H2 norm for every level of the H-infinity norm, over the network.",
        facts=[("designs", str(len(found)))],
    )


def trigger_page(
    name: str, kind: str, points: Sequence[TriggerPoint], best: Sequence[TriggerPoint], open_points: Sequence[OpenPoint] = ()
) -> str:
    """Return the page.

    Args:
        name: of the experiment.
        kind: of the trigger.
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
        x_unit="1/s", y_label="squared error", x_log=True, y_log=True, sync=None, height_px=320, note="means over the runs",
    )  # fmt: skip
    rows: list[list[Cell]] = [
        [
            each.of.threshold, each.of.share, "  ".join(f"{v:.4g}" for v in each.of.gain.ravel()),
            None if each.stopped else each.cost.value, None if each.stopped else each.cost.half_width, each.packets.value,
            each.packets.half_width, each.stopped, Badge(label=each.state, state=STATES.get(each.state, "neutral")), each.bound,
            ", ".join(f"{output} {value:.3g}" for output, value in each.ends_within.items()), "yes" if each in best else "",
        ]
        for each in points
    ]  # fmt: skip
    columns = ["threshold", "designed for share", "gain", "squared error", "±", "packets/s", "±", "runs stopped", "certificate"]
    columns += ["H2 norm at most", "ends within (rms)", "best"]
    tables = [Table(columns=columns, rows=rows, wide=True)]
    if open_points:
        left: list[list[Cell]] = [[each.threshold, each.designed_for_share, each.why] for each in open_points]
        tables.append(Table(columns=["undecided: threshold", "designed for share", "why"], rows=left, wide=True))
    return render_page(
        f"Event trigger: {name}",
        [Section(title="Threshold and gain", blocks=(figure, *tables))],
        kicker="hilrig · design",
        subtitle=f"A {kind} trigger: every threshold with the gain for no trigger, and with gains that know its error.",
        facts=[("points", str(len(points))), ("runs of each", str(points[0].packets.n))],
    )
