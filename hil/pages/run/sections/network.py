"""What the emulated network did: delays over time, and frequencies beside its law."""

from __future__ import annotations

from hil.measure.network_paths import network_paths
from hil.measure.view import RunView
from hil.pages.html.figures import Section
from hil.pages.run.page_summary import page_summary
from hil.pages.run.statistics import network_blocks, network_table
from hil.pages.run.time_panels import delay_panels, markers


def delays(view: RunView) -> Section:
    """Return the delays of both directions over time, and a row for each emulated network."""
    found = network_table(view.once(page_summary)["network"], view.once(network_paths))
    return Section(
        title="Delays",
        place=30,
        intro="The broad line is the delay that the emulated network drew, the thin line what the receiver measured "
        "from time stamps. They differ where a packet was late, lost or still on its way.",
        blocks=(*delay_panels(view, view.once(markers)), found),
    )


def statistics(view: RunView) -> Section | None:
    """Return frequencies, transitions and sojourns beside what the network laws state."""
    blocks = tuple(network_blocks(view.run, view.once(page_summary)["network"], view.once(network_paths)))
    return Section(title="Network against its law", place=50, columns=2, blocks=blocks) if blocks else None


SECTIONS = (delays, statistics)
