"""The page of an identified network law: measured and fitted side by side."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import special

from hil.pages.html.figures import Badge, BarGroup, Bars, Block, Figure, Section, Series, Table
from hil.pages.html.page import render_page
from transport.law_fit.law_fit import LawFit
from transport.law_fit.packet_record import ages_of
from transport.law_fit.proportions import LAGS
from transport.law_fit.region import arrivals

POINTS = 400
MOST_BARS = 12


def law_page(fits: dict[str, LawFit], said: dict[str, dict[str, Any]], model_shares: dict[str, list[float]]) -> str:
    """Return the page.

    Args:
        fits: by direction.
        said: see `hil.recordings.law_text.fit_said`.
        model_shares: share of slots at age 0, 1, ... under each fitted law.
    """
    badges = [
        Badge(label=f"{way}: {fit.law_class}", state="warning" if fit.law_class == "none" else "good")
        for way, fit in fits.items()
    ]
    return render_page(
        "Which law is this network?", [_section(way, fit, said[way], model_shares.get(way, [])) for way, fit in fits.items()],
        kicker="hilrig · identified network law", badges=badges,
        subtitle="What was measured, and what the fitted law says, on one axis each.",
        facts=tuple((name, str(said[way]["packets"]) + " packets") for way, name in ((w, w) for w in fits)),
    )  # fmt: skip


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
    bars = min(MOST_BARS, max(len(counted), len(shares)))
    blocks.append(Bars(
        title="Age of the newest packet", categories=[str(i) for i in range(bars)], x_label="age in slots",
        y_label="share of slots",
        groups=(BarGroup(label="measured", values=_padded(counted.tolist(), bars)),
                BarGroup(label=f"law: {fit.law_class}", values=_padded(shares, bars), hollow=True)),
        note=f"Slots of {fit.period_s * 1e3:g} ms that close after {fit.deadline_s * 1e3:g} ms.",
    ))  # fmt: skip
    blocks.append(_correlations(fit))
    rows: list[tuple[str | float | int, ...]] = [
        (c.name, c.fitted_to, c.parameters, round(c.bic, 1), *(f"{p:.2g}" for p in (c.fitness.neighbours, c.fitness.shape)))
        if c.fitness is not None else (c.name, c.fitted_to, c.parameters, round(c.bic, 1), "-", "-")
        for c in fit.candidates
    ]  # fmt: skip
    blocks.append(Table(columns=("law", "fitted to", "parameters", "BIC", "p independent", "p shape"), rows=rows))
    came_rows = [(i, share, *pair) for i, (share, pair) in enumerate(arrivals(fit).shares())]
    blocks.append(Table(columns=("age in slots", "comes, if not before", "95 % from", "to"), rows=came_rows[:MOST_BARS]))
    intro = f"{fit.law_class}; {said['packets']} packets, {said['lost']} did not come. " + " ".join(
        f"{note}." for note in said["notes"]
    )
    return Section(
        title={"sc": "Sensor to controller", "ca": "Controller to actuator"}.get(way, "Round trip"),
        intro=intro,
        blocks=tuple(blocks),
        columns=2,
    )


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
