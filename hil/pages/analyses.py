"""Pages of analyses without a run: an identified network law, a stiffness map."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from scipy import special

from design.passivity.stiffness_map import StiffnessCell
from design.passivity.synthesis import ceiling_n_per_m
from hil.log.recordings import ROUND_TRIP, class_text, fitted_value, independence_text, latencies_text
from hil.pages import Badge, BarGroup, Bars, Block, Figure, LineStyle, Section, Series, Table, Text
from hil.pages.html import capital
from hil.pages.html.page import Page
from transport.law_fit import LawFit
from transport.law_fit.packet_record import ages_of
from transport.law_fit.proportions import LAGS, REJECT, arrivals

WAYS: Final = {"sc": "sensor to controller", "ca": "controller to actuator", ROUND_TRIP: ROUND_TRIP}
POINTS = 400
MOST_BARS = 12
MOST_PARAMETERS = 20
SEEN = 1e-3
"""A share of slots that a bar can show."""


def law_page(fits: dict[str, LawFit], said: dict[str, dict[str, Any]], model_shares: dict[str, list[float]]) -> str:
    """Return the page of an identified network law: measured and fitted side by side.

    Args:
        fits: by direction.
        said: see `hil.log.recordings.fit_document`.
        model_shares: share of slots at age 0, 1, ... under each fitted law.
    """
    badges = [
        Badge(label=f"{WAYS[way]}: {class_text(fit)}", state="warning" if fit.law_class == "none" else "good")
        for way, fit in fits.items()
    ]
    return Page(
        "Which law is this network?", [_section(way, fit, said[way], model_shares.get(way, [])) for way, fit in fits.items()],
        kicker="hilrig · identified network law", badges=badges,
        subtitle="What was measured, and what the fitted law says, on one axis each.",
        facts=tuple((WAYS[way], f"{said[way]['packets']} packets") for way in fits),
    ).html()  # fmt: skip


def _section(way: str, fit: LawFit, said: dict[str, Any], shares: list[float]) -> Section:
    record = fit.record
    came = np.sort(record.latency_s[record.came])
    levels = (np.arange(len(came)) + 1.0) / len(came)
    some = np.unique(np.linspace(0, len(came) - 1, POINTS).astype(int))
    fitted = f"fitted: {fit.latencies.name}"
    blocks: list[Block] = [
        Figure(
            title="Latency: share of packets that came within", x_label="latency", x_unit="ms", y_label="share", sync=None,
            series=(
                Series(label="measured", x=came[some] * 1e3, y=levels[some], style="step"),
                Series(label=fitted, x=came[some] * 1e3, y=fit.latencies.cdf(came[some]), style="dashed"),
            ), y_range=(0.0, 1.0),
        ),
        Figure(
            title="Latency: share of packets later than", x_label="latency", x_unit="ms", y_label="share", y_log=True, sync=None,
            series=(
                Series(label="measured", x=came[some[:-1]] * 1e3, y=1.0 - levels[some[:-1]], style="step"),
                Series(label=fitted, x=came[some[:-1]] * 1e3,
                       y=np.maximum(1.0 - fit.latencies.cdf(came[some[:-1]]), 0.1 / len(came)), style="dashed"),
            ), note="The tail: what decides how old a packet gets.",
        ),
    ]  # fmt: skip
    ages = ages_of(record, fit.period_s, fit.deadline_s)
    counted = np.bincount(ages) / len(ages)
    bars = min(MOST_BARS, max(len(counted), sum(share >= SEEN for share in shares)))
    blocks.append(Bars(
        title="Age of the newest packet", categories=[str(i) for i in range(bars)], x_label="age in slots",
        y_label="share of slots",
        groups=(BarGroup(label="measured", values=_padded(counted.tolist(), bars)),
                BarGroup(label=f"law: {fit.law_class}", values=_padded(shares, bars), hollow=True)),
        note=f"Slots of {fit.period_s * 1e3:g} ms that close after {fit.deadline_s * 1e3:g} ms.",
    ))  # fmt: skip
    blocks.append(_correlations(fit))
    rows: list[tuple[str | float | int, ...]] = [
        (f"ages: {c.name}" if c.fitted_to == "ages" else c.name, c.parameters, round(c.bic),
         *(("-", "-") if c.fitness is None else (_chance(c.fitness.independence), _chance(c.fitness.shape))))
        for c in fit.candidates
    ]  # fmt: skip
    came_rows = [(i, share, *(pair or ("-", "-"))) for i, (share, pair) in enumerate(arrivals(fit).shares())]
    blocks.append(Table(columns=("age in slots", "comes, if not before", "95 % from", "to"), rows=came_rows[:MOST_BARS]))
    parameters = [(name, fitted_value(fit, name), *pair) for name, pair in said["intervals"].items()]
    blocks.append(Table(columns=("parameter of the law", "fitted", "95 % from", "to"), rows=parameters[:MOST_PARAMETERS]))
    blocks.append(Table(columns=("law that was tried", "parameters", "BIC", "independent: p", "shape: p"), rows=rows))
    tested = map(capital, independence_text(fit))
    intro = f"The law: {class_text(fit)}; {said['packets']} packets, {said['lost']} did not come. " + " ".join(
        f"{note}." for note in (*tested, capital(latencies_text(fit)), *map(_sentence, said["notes"]))
    )
    return Section(title=capital(WAYS[way]), intro=intro, blocks=tuple(blocks), columns=2)


def _sentence(note: str) -> str:
    """A note of a fit, which names a direction by its key, as a page says it."""
    way, colon, rest = note.partition(": ")
    return capital(WAYS[way] + colon + rest if way in WAYS else note)


def _chance(p: float) -> str:
    """A p-value; below 0.001 only that counts. The spaces do not break."""
    return f"{p:.2g}" if p >= REJECT else f"< {REJECT:g}".replace(" ", "\N{NO-BREAK SPACE}")


def _correlations(fit: LawFit) -> Figure:
    """Correlations of the normal scores of latencies, by rank, with what chance alone gives."""
    values = fit.record.latency_s[fit.record.came]
    rank = np.argsort(np.argsort(values, kind="stable"), kind="stable")
    score = special.ndtri((rank + 0.5) / len(rank))
    power = float(score @ score)
    lags = np.arange(1, LAGS + 1)
    r = np.array([float(score[:-k] @ score[k:]) / power for k in lags]) if power > 0.0 else np.zeros(LAGS)
    chance = 2.0 / np.sqrt(len(score))
    return Figure(
        title="Correlation of a latency with those after it", x_label="lag", x_unit="packets", y_label="correlation", sync=None,
        series=(Series(label="measured", x=lags.astype(float), y=r, style="points"),
                Series(label="chance: 95 %", x=lags.astype(float), y=np.full(LAGS, chance), style="dashed", colour=7),
                Series(label="chance: 95 %, below", x=lags.astype(float), y=np.full(LAGS, -chance), style="dashed", colour=7)),
        note="Independent latencies have none.",
    )  # fmt: skip


def _padded(values: list[float], n: int) -> list[float]:
    return [*values[:n], *[0.0] * (n - len(values))]


LEVELS = (1.0, 2.0, 5.0)


def stiffness_page(cells: Sequence[StiffnessCell], *, mass_kg: float, damping_n_s_per_m: float) -> Page:
    """Return the page of a stiffness map.

    It draws contours over delay and hand damping, and stiffness over delay; every cell has its taps.

    Args:
        cells: the map.
        mass_kg, damping_n_s_per_m: of the device at its tip.
    """
    sections = [stiffness_section(period, [c for c in cells if c.period_s == period], damping_n_s_per_m)
                for period in dict.fromkeys(c.period_s for c in cells)]  # fmt: skip
    return Page(
        "How stiff may a virtual wall be?",
        sections,
        kicker="hilrig · stiffness map",
        subtitle="Safe for every passive hand and every passive wall, at every delay up to the one shown. No wall "
        "above the ceiling is safe.",
        facts=(("device", f"{mass_kg:g} kg, {damping_n_s_per_m:g} N s/m at the tip"),),
    )


def stiffness_section(period_s: float, cells: Sequence[StiffnessCell], damping: float) -> Section:
    """Return the section of one period: a certified value at the delays that were computed, a ceiling at all between.

    Args:
        period_s: the period.
        cells: those of the map at this period.
        damping: of the device at its tip, N s/m.
    """
    rate = f"{1e3 * period_s:g} ms"
    delays = sorted({c.delay_samples for c in cells})
    x = list(range(delays[0], delays[-1] + 1))
    hands = list(dict.fromkeys(c.hand_damping_n_s_per_m for c in cells))

    def at(hand: float, value: Callable[[StiffnessCell], float | None]) -> list[float]:
        """Values over x, NaN at a delay that was not computed: a line joins neighbours only."""
        found = {c.delay_samples: value(c) for c in cells if c.hand_damping_n_s_per_m == hand}
        return [math.nan if (y := found.get(d)) is None else y for d in x]

    curves = []
    for i, hand in enumerate(hands):
        safe = at(hand, lambda c: c.certified_n_per_m)
        curves.append(Series(label=f"certified, hand {hand:g} N s/m", x=x, y=safe, colour=i, marked=True))
        ceiling = [ceiling_n_per_m(period_s, damping + hand, d) for d in x]
        curves.append(Series(label=f"ceiling, hand {hand:g} N s/m", x=x, y=ceiling, colour=i, style="dashed"))
    number, first = len(hands), f"hand {hands[0]:g} N s/m"
    gil_hulin, colgate, exact = (
        at(hands[0], value)
        for value in (lambda c: c.gil_hulin_n_per_m, lambda c: c.colgate_n_per_m, lambda c: c.exact_n_per_m)
    )
    curves += [
        Series(label=f"Gil-Hulin, {first}", x=x, y=gil_hulin, colour=number, style="circles"),
        Series(label="no coupler, no hand (exact)", x=x, y=exact, colour=number + 2, style="points"),
        Series(label=f"Colgate, {first}", x=x, y=colgate, colour=number + 1, style="points"),
    ]
    blocks: list[Block] = []
    if len(delays) > 1:
        ticks = tuple(map(float, delays))
        blocks += [
            Figure(
                title=f"Contours at T = {rate}: hand damping that a stiffness takes",
                series=_contours(period_s, x, at, hands, damping), x_label="largest delay", x_unit="samples",
                y_label="hand damping", y_unit="N s/m", sync=None, y_range=(0.0, max(*hands, 1.0)), x_ticks=ticks,
                note="Points: certified, at the delays that were computed; a line joins delays one sample apart. Dashed: the "
                "ceiling of the same stiffness. Below its points a stiffness is not certified; below its dashed line impossible.",
            ),
            Figure(
                title=f"Stiffness at T = {rate}", series=tuple(curves), x_label="largest delay", x_unit="samples",
                y_label="stiffness", y_unit="N/m", y_log=True, sync=None, x_ticks=ticks,
                note="A coupler is safe at every delay up to its own. Gil-Hulin, Colgate, exact: what is quoted for a wall "
                "without a coupler, with the least hand; the table has all. Colgate's b > K T/2 knows no delay.",
            ),
        ]  # fmt: skip
    damped = "hand N\N{NO-BREAK SPACE}s/m"  # in one line of a narrow column
    columns = ("samples late", damped, "certified N/m", "ceiling N/m", "Colgate N/m", "Gil-Hulin N/m", "exact, no hand N/m")
    rows = [
        (f"0..{c.delay_samples}", c.hand_damping_n_s_per_m, c.certified_n_per_m, c.ceiling_n_per_m, c.colgate_n_per_m,
         c.gil_hulin_n_per_m, c.exact_n_per_m)
        for c in cells
    ]  # fmt: skip
    lists = [
        "\n    ".join([f"delays 0..{c.delay_samples}, hand {c.hand_damping_n_s_per_m:g} N s/m", *map(repr, c.taps_m_per_n)])
        for c in cells
    ]
    taps = Text(title=f"Taps in m/N of all {len(cells)} couplers", code=True, folded=True, text="\n\n".join(lists))
    note = "Colgate, Gil-Hulin, exact: a wall without a coupler and without damping of its own; the last for no hand at all."
    return Section(title=f"T = {rate}", blocks=(*blocks, Table(columns=columns, rows=rows, note=note), taps))


def _contours(
    period_s: float, x: Sequence[int], at: Callable[[float, Callable[[StiffnessCell], float | None]], list[float]],
    hands: Sequence[float], damping: float,
) -> tuple[Series, ...]:  # fmt: skip
    """b_h = K/K_1 - b, as every stiffness is proportional to b + b_h."""
    most = max(hands)
    certified = np.array(at(hands[0], lambda c: c.certified_n_per_m)) / (damping + hands[0])
    ceiling = np.array([ceiling_n_per_m(period_s, 1.0, d) for d in x])
    low, high = damping * np.nanmin(certified), (damping + most) * ceiling.max()
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    levels = [m * 10.0**e for e in decades for m in LEVELS if low < m * 10.0**e < high][:8]
    out = []
    for i, level in enumerate(levels):
        for label, per, computed in (("", certified, True), (" ceiling", ceiling, False)):
            y = np.where((need := level / per - damping) < 0.0, np.nan, need)
            if (y <= most).any():  # else it has no point in the picture
                style: LineStyle = "line" if computed else "dashed"
                out.append(Series(label=f"{level:g} N/m{label}", x=x, y=y, colour=i, style=style, marked=computed))
    return tuple(out)
