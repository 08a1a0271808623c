"""The page of a stiffness map: contours over delay and hand damping, stiffness over delay, every cell with its taps."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from design.passivity.stiffness_map import StiffnessCell
from hil.pages.html.figures import Block, Figure, Section, Series, Table, Text
from hil.pages.html.page import render_page

LEVELS = (1.0, 2.0, 5.0)


def stiffness_page(cells: Sequence[StiffnessCell], *, mass_kg: float, damping_n_s_per_m: float) -> str:
    """Return the page.

    Args:
        cells: the map.
        mass_kg, damping_n_s_per_m: of the device at its tip.
    """
    sections = [_rate(period, [c for c in cells if c.period_s == period], damping_n_s_per_m)
                for period in dict.fromkeys(c.period_s for c in cells)]  # fmt: skip
    return render_page(
        "How stiff may a virtual wall be?",
        sections,
        kicker="hilrig · stiffness map",
        subtitle="Safe for every passive hand and every passive wall, at every delay up to the one shown. No wall "
        "above the ceiling is safe.",
        facts=(("device", f"{mass_kg:g} kg, {damping_n_s_per_m:g} N s/m at the tip"),),
    )


def _rate(period_s: float, cells: Sequence[StiffnessCell], damping: float) -> Section:
    rate = f"{1e3 * period_s:g} ms"
    delays = sorted({c.delay for c in cells})
    hands = list(dict.fromkeys(c.hand_damping_n_s_per_m for c in cells))
    curves = []
    for i, hand in enumerate(hands):
        mine = sorted((c for c in cells if c.hand_damping_n_s_per_m == hand), key=lambda c: c.delay)
        x = [float(c.delay) for c in mine]
        safe = [c.certified_n_per_m for c in mine]
        curves.append(Series(label=f"certified, hand {hand:g}", x=x, y=safe, colour=i, marked=True))
        ceiling = [c.ceiling_n_per_m for c in mine]
        curves.append(Series(label=f"ceiling, hand {hand:g}", x=x, y=ceiling, colour=i, style="dashed", marked=True))
    alone = [c for c in cells if c.hand_damping_n_s_per_m == hands[0]]
    x, first = [float(c.delay) for c in alone], f"hand {hands[0]:g}"
    undelayed = [math.nan if c.colgate_n_per_m is None else c.colgate_n_per_m for c in alone]
    number = len(hands)
    curves += [
        Series(label=f"Gil-Hulin, {first}", x=x, y=[c.gil_hulin_n_per_m for c in alone], colour=number, style="points"),
        Series(label=f"Colgate, {first}", x=x, y=undelayed, colour=number + 1, style="circles"),
        Series(label="no coupler, no hand (exact)", x=x, y=[c.exact_n_per_m for c in alone], colour=number + 2, style="points"),
    ]
    ticks = tuple(map(float, delays))
    blocks: list[Block] = []
    if len(delays) > 1:
        blocks += [
            Figure(
                title=f"Contours at T = {rate}: hand damping that a stiffness takes",
                series=_contours(cells, damping, max(hands)), x_label="largest delay", x_unit="samples",
                y_label="hand damping", y_unit="N s/m", sync=None, y_range=(0.0, max(*hands, 1.0)), x_ticks=ticks,
                note="Solid: certified. Dashed: the ceiling of the same stiffness. Right of and below a solid line that "
                "stiffness is not certified; of a dashed line, impossible. Computed at the delays that are named, not between.",
            ),
            Figure(
                title=f"Stiffness at T = {rate}", series=tuple(curves), x_label="largest delay", x_unit="samples",
                y_label="stiffness", y_unit="N/m", y_log=True, sync=None, x_ticks=ticks,
                note="Points and circle: what the field quotes for a wall without a coupler, with the least hand; the table has "
                "all. Colgate's b > K T/2 knows no delay.",
            ),
        ]  # fmt: skip
    columns = ("delay", "hand N s/m", "certified N/m", "ceiling N/m", "Colgate N/m", "Gil-Hulin N/m", "exact, no hand N/m")
    rows = [
        (f"0..{c.delay}", c.hand_damping_n_s_per_m, c.certified_n_per_m, c.ceiling_n_per_m, c.colgate_n_per_m,
         c.gil_hulin_n_per_m, c.exact_n_per_m)
        for c in cells
    ]  # fmt: skip
    lists = [
        f"delays 0..{c.delay}, hand {c.hand_damping_n_s_per_m:g} N s/m\n" + "\n".join(f"    {tap!r}" for tap in c.taps_m_per_n)
        for c in cells
    ]
    taps = Text(title=f"Taps in m/N of all {len(cells)} couplers", code=True, folded=True, text="\n\n".join(lists))
    return Section(title=f"T = {rate}", blocks=(*blocks, Table(columns=columns, rows=rows), taps))


def _contours(cells: Sequence[StiffnessCell], damping: float, most: float) -> tuple[Series, ...]:
    """b_h = K/K_1 - b, as every stiffness is proportional to b + b_h."""
    one = {c.delay: c for c in cells}
    delays = sorted(one)
    certified, ceiling = (
        np.array([value / (damping + one[d].hand_damping_n_s_per_m) for d, value in pairs])
        for pairs in ([(d, one[d].certified_n_per_m) for d in delays], [(d, one[d].ceiling_n_per_m) for d in delays])
    )
    low, high = damping * certified.min(), (damping + most) * ceiling.max()
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    levels = [m * 10.0**e for e in decades for m in LEVELS if low < m * 10.0**e < high][:8]
    x, out = [float(d) for d in delays], []
    for i, level in enumerate(levels):
        for label, per, style in (("", certified, "line"), (" ceiling", ceiling, "dashed")):
            y = np.where((need := level / per - damping) < 0.0, np.nan, need)
            if (y <= most).any():  # else it has no point in the picture
                name = f"{level:g} N/m{label}"
                out.append(Series(label=name, x=x, y=y, colour=i, style="line" if style == "line" else "dashed", marked=True))
    return tuple(out)
