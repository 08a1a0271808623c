"""The page of an analysed CAN bus: every message with its bound, its deadline, and who delays it."""

from __future__ import annotations

from hil.design_questions.bus_analysis import AnalysedMessage, BusAnalysis
from hil.pages.html.figures import Badge, BarGroup, Bars, Cell, Section, Table
from hil.pages.html.page import render_page


def bus_page(found: BusAnalysis) -> str:
    """Return the page."""
    late = sum(not each.in_time for each in found.messages)
    verdict = Badge(label="every message meets its deadline", state="good")
    if late:
        verdict = Badge(label=f"{late} of {len(found.messages)} messages may miss their deadline", state="bad")
    bars = Bars(
        title="Response times", categories=[said(each) for each in found.messages], y_label="response", y_unit="ms",
        groups=(
            BarGroup(label="measured", values=[each.measured_ms or 0.0 for each in found.messages]),
            BarGroup(label="bound", values=[each.bound_ms or 0.0 for each in found.messages], hollow=True),
        ),
        note="By priority. A message without a bar of its bound has none.",
    )  # fmt: skip
    rate = f"{found.bitrate:,} bit/s" + (f", data {found.dbitrate:,} bit/s" if found.dbitrate else "")
    return render_page(
        f"CAN bus: {found.name}",
        [Section(title="Messages", blocks=(_table(found), bars))],
        kicker="hilrig · CAN bus",
        subtitle="Worst-case response times after Davis, Burns, Bril and Lukkien 2007, for nodes that queue by priority, to the "
        "end of EOF.",
        badges=[verdict],
        facts=[("rate", rate), ("load", f"{100 * found.load:.2f} %"), ("simulated", f"{found.simulated_s:g} s")],
    )  # fmt: skip


def said(message: AnalysedMessage) -> str:
    """Return the identifier of a message as tools for CAN write it."""
    return f"{message.can_id:08X}" if message.extended else f"{message.can_id:03X}"


def _table(found: BusAnalysis) -> Table:
    rows: list[list[Cell]] = []
    for place, each in enumerate(found.messages):
        meets = Badge(label="yes", state="good") if each.in_time else Badge(label="no", state="bad")
        above = "-" if not place else f"{len(each.delayed_by)}: {', '.join(each.delayed_by[-3:])}"
        rows.append([
            said(each), each.name, each.length, each.frame_ms, each.period_ms, each.deadline_ms, each.bound_ms, each.measured_ms,
            meets, above,
        ])  # fmt: skip
    columns = [
        "identifier", "message", "bytes", "frame, ms", "period, ms", "deadline, ms", "bound, ms", "measured, ms", "in time",
        "delayed by",
    ]  # fmt: skip
    return Table(
        columns=columns, rows=rows, wide=True,
        note="Delayed by: how many messages win over it, and the last three of them; beside these one frame of any other may be "
        "on the bus already.",
    )  # fmt: skip
