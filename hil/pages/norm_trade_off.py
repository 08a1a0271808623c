"""The page of `hil design --trade-off`: H2 norm against H-infinity norm."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.design_questions.norm_trade_off import Compromise
from hil.pages.html.figures import Cell, Figure, Section, Series, Table
from hil.pages.html.page import render_page


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
