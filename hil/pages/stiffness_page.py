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
        curves.append(Series(label=f"certified, hand {hand:g}", x=x, y=[c.certified_n_per_m for c in mine], colour=i))
        curves.append(Series(label=f"ceiling, hand {hand:g}", x=x, y=[c.ceiling_n_per_m for c in mine], colour=i, style="dashed"))
        delayed = [c.gil_hulin_n_per_m for c in mine]
        curves.append(Series(label=f"Gil-Hulin, hand {hand:g}", x=x, y=delayed, colour=i, style="points"))
        undelayed = [math.nan if c.colgate_n_per_m is None else c.colgate_n_per_m for c in mine]
        curves.append(Series(label=f"Colgate, hand {hand:g}", x=x, y=undelayed, colour=i, style="points"))
    alone = [c for c in cells if c.hand_damping_n_s_per_m == hands[0]]
    bare = Series(
        label="no coupler, no hand (exact)",
        x=[float(c.delay) for c in alone],
        y=[c.exact_n_per_m for c in alone],
        colour=len(hands),
        style="points",
    )
    blocks: list[Block] = []
    if len(delays) > 1:
        blocks += [
            Figure(
                title=f"Contours at T = {rate}: hand damping that a stiffness takes",
                series=_contours(cells, damping, max(hands)), x_label="largest delay", x_unit="samples",
                y_label="hand damping", y_unit="N s/m", sync=None, y_range=(0.0, max(*hands, 1.0)),
                note="Solid: certified. Dashed: the ceiling of the same stiffness. Right of and below a solid line that "
                "stiffness is not certified; of a dashed line, impossible.",
            ),
            Figure(
                title=f"Stiffness at T = {rate}", series=(*curves, bare), x_label="largest delay", x_unit="samples",
                y_label="stiffness", y_unit="N/m", y_log=True, sync=None,
                note="Points: what the field quotes for a wall without a coupler. Colgate's b > K T/2 knows no delay.",
            ),
        ]  # fmt: skip
    columns = ("delay", "hand N s/m", "certified N/m", "ceiling N/m", "Colgate N/m", "Gil-Hulin N/m", "exact, no hand N/m")
    rows = [
        (f"0..{c.delay}", c.hand_damping_n_s_per_m, c.certified_n_per_m, c.ceiling_n_per_m, c.colgate_n_per_m,
         c.gil_hulin_n_per_m, c.exact_n_per_m)
        for c in cells
    ]  # fmt: skip
    taps = [
        Text(
            title=f"Taps in m/N: delays 0..{c.delay}, hand {c.hand_damping_n_s_per_m:g} N s/m", code=True, folded=True,
            text="\n".join(f"{tap!r}" for tap in c.taps_m_per_n),
        )
        for c in cells
    ]  # fmt: skip
    return Section(title=f"T = {rate}", blocks=(*blocks, Table(columns=columns, rows=rows), *taps))


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
            out.append(Series(label=f"{level:g} N/m{label}", x=x, y=y, colour=i, style="line" if style == "line" else "dashed"))
    return tuple(out)
