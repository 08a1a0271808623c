"""What a run says of its network and of its times: frequencies against the law, transitions, fates, histograms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.log.append_column import pieces, whole
from hil.log.run import Run
from hil.log.topics import APPLIED, ROWS, TIMING
from hil.measure.network_paths import NetworkPath, expected_frequencies, expected_transitions, mode_sequence, network_paths
from hil.measure.summary import POINTS, page_summary
from hil.measure.view import RunView
from hil.pages import Badge, BarGroup, Bars, Block, Histogram, Marker, Matrix, Section, Table
from hil.pages.html import capital, text_of
from transport.law_tests import is_testable
from transport.laws import ChainLaw, NetworkLaw, RecordedLaw, SemiMarkovLaw
from transport.laws.sojourn import hazards

DOUBTFUL = 0.01
"""A p-value below this is marked: it happens to one right run in a hundred."""

BINS = 70
FEWEST_SOJOURNS = 20
LONGEST = 16
DIRECTIONS: Mapping[str, tuple[str, str]] = {"sc": ("sensor to controller", "τ"), "ca": ("controller to actuator", "d")}
MEASURED: Mapping[str, tuple[str, str, str]] = {"sc": (ROWS.name, "tau", "sample_ns"), "ca": (APPLIED.name, "d", "d")}
"""Topic and field of the age that the receiver of a direction measured, and a field that is negative where it had none."""


def against_laws(view: RunView) -> Section | None:
    """Return frequencies, transitions and sojourns of every emulated network beside what its law states."""
    network, paths = view.once(page_summary)["network"], view.once(network_paths)
    blocks: list[Block] = []
    for path, way, found in _numbers(network, paths):
        law, symbol = path.law, DIRECTIONS[path.side][1]
        if len(found["mode_counts"]) < 2:
            continue
        ages: Sequence[int] = law.mode_ages if isinstance(law, ChainLaw | SemiMarkovLaw) else range(0)
        plain = isinstance(law, RecordedLaw) or list(ages) == list(range(len(found["mode_counts"])))
        what = f"{symbol} (samples)" if plain else "mode of the law"
        blocks.append(_frequencies(found, law, f"{capital(way)}: mode frequencies", what))
        blocks.append(_transitions(found, law, f"{capital(way)}: transitions", symbol if plain else "mode"))
        blocks += _sojourns(path, way, symbol)
    blocks += [block for side in DIRECTIONS if (block := _measured_ages(view.run, network, paths, side)) is not None]
    return Section(title="Network against its law", place=50, columns=2, blocks=tuple(blocks)) if blocks else None


def _numbers(network: Mapping[str, Any], paths: Sequence[NetworkPath]) -> list[tuple[NetworkPath, str, Mapping[str, Any]]]:
    """Every path with its name for people and its numbers."""
    alone = sum(path.side == "sc" for path in paths) == 1
    return [
        (
            path,
            DIRECTIONS[path.side][0] if path.side == "ca" or alone else f"{path.node} to controller",
            network["ca"] if path.side == "ca" else network["nodes"][path.node],
        )
        for path in paths
    ]


def verdict(found: Mapping[str, Any], path: NetworkPath) -> Badge:
    """Return whether the record of a network agrees with its law, which says nothing of a medium before it."""
    p, law = found["p_value"], path.law
    if p == 1.0 and len(found["mode_counts"]) == 1:  # nothing was left to chance
        if path.medium:
            return Badge(label="no test", detail=f"for {path.medium}")
        return Badge(label="one mode", detail="nothing is random")
    if p is None and law is not None and is_testable(law):
        return Badge(label="no test", detail="too few slots")
    if p is None:
        return Badge(label="no test", detail=f"for a law of kind {found['law']}")
    if p < DOUBTFUL:
        return Badge(label="differs from its law", state="warning", detail=f"p = {text_of(p, 3)}")
    return Badge(label="agrees with its law", state="good", detail=f"p = {text_of(p, 3)}")


def network_table(network: Mapping[str, Any], paths: Sequence[NetworkPath]) -> Table:
    """Return one row per emulated network: law, verdict, and what became of the packets."""
    numbers = _numbers(network, paths)
    fates = sorted({fate for _, _, found in numbers for fate in found["fates"]} - {"lost", "duplicated"})
    heads = [fate.replace("-", " ") for fate in fates]
    rows = [
        [
            capital(way),
            found["through"],
            verdict(found, path),
            found["lost"],
            found["late"],
            found["duplicated"],
            *(found["fates"].get(fate, 0) for fate in fates),
        ]
        for path, way, found in numbers
    ]
    return Table(
        columns=["direction", "network", "test of the record", "lost", "late", "duplicated", *heads],
        rows=rows,
        note="The p-value is the probability of a record at least as unlike the law, if the law is right: below "
        f"{DOUBTFUL:g} in one right run of a hundred. Late packets missed the deadline of their slot and count as lost."
        + (" None yet: slots before the first packet could arrive." if "none-yet" in fates else ""),
    )


def _shares(
    title: str, counted: npt.NDArray[np.float64], stated: tuple[str, npt.NDArray[np.float64]] | None, x_label: str, *,
    of: str = "slots", label: str = "counted", note: str = "", categories: Sequence[str] = (),
) -> Bars:  # fmt: skip
    """Return shares as they were counted, and hollow beside them what a law states, named, where it states as many."""
    groups = [BarGroup(label=label, values=counted.tolist(), colour=0)]
    if stated is not None and len(stated[1]) == len(counted):
        groups.append(BarGroup(label=stated[0], values=stated[1].tolist(), colour=7, hollow=True))
    return Bars(
        title=title, categories=categories or [str(i) for i in range(len(counted))], groups=tuple(groups), x_label=x_label,
        y_label=f"share of {of}", note=note,
    )  # fmt: skip


def _frequencies(found: Mapping[str, Any], law: NetworkLaw | None, title: str, what: str) -> Bars:
    counts = np.asarray(found["mode_counts"], dtype=np.float64)
    frequencies = expected_frequencies(law)
    stated = None if frequencies is None else ("stationary law", frequencies)
    slots = int(counts.sum())
    return _shares(title, counts / max(slots, 1), stated, what, note=f"{text_of(slots)} slot{'s' * (slots != 1)}.")


def _transitions(found: Mapping[str, Any], law: NetworkLaw | None, title: str, symbol: str) -> Matrix:
    counts = np.asarray(found["transition_counts"], dtype=np.float64)
    totals = counts.sum(axis=1, keepdims=True)
    shares = np.divide(counts, totals, out=np.full_like(counts, np.nan), where=totals > 0)
    stated = expected_transitions(law)
    fits = stated is not None and stated.shape == counts.shape
    names = [str(i) for i in range(len(counts))]
    return Matrix(
        title=title,
        rows=[f"{name}  ({text_of(int(n))}×)" for name, n in zip(names, totals[:, 0])],
        columns=names,
        values=shares.tolist(),
        expected=stated.tolist() if fits and stated is not None else None,
        row_label=f"{symbol} in slot k",
        column_label="k + 1",
        note="Counted share of each row" + (", beneath it what the law states." if fits else "."),
    )


def _sojourns(path: NetworkPath, way: str, symbol: str) -> list[Block]:
    """How long every mode of a semi-Markov law lasted, beside its sojourn law; modes met too rarely are left out."""
    law = path.law
    if not isinstance(law, SemiMarkovLaw) or path.draws is None:
        return []
    modes = mode_sequence(path.draws)
    starts = np.flatnonzero(np.diff(modes)) + 1
    # The first sojourn has no known begin, the last no known end.
    lengths, owners = np.diff(starts), modes[starts[:-1]]
    blocks: list[Block] = []
    for mode, sojourn in enumerate(law.sojourn):
        mine = lengths[owners == mode]
        if mine.size < FEWEST_SOJOURNS:
            continue
        longest = min(int(mine.max()), LONGEST)
        counted = np.bincount(np.minimum(mine, longest + 1), minlength=longest + 2)[1:] / mine.size
        hazard = hazards(sojourn, longest)
        stays = np.concatenate(([1.0], np.cumprod(1.0 - hazard)))
        stated = np.append(hazard * stays[:-1], stays[-1])
        title, x_label = f"{capital(way)}: how long mode {mode} lasted", f"slots with {symbol} in mode {mode}"
        names = [*(str(n) for n in range(1, longest + 1)), f"> {longest}"]
        note = f"{text_of(int(mine.size))} whole sojourns."
        blocks.append(_shares(title, counted, ("sojourn law", stated), x_label, of="sojourns", note=note, categories=names))
    return blocks


def _measured_ages(run: Run, network: Mapping[str, Any], paths: Sequence[NetworkPath], side: str) -> Bars | None:
    """Ages as their receiver measured them, where no law has them as its modes: packet laws, media."""
    if not ("sent" in network[side]["fates"] or any(path.medium for path in paths if path.side == side)):
        return None
    topic, field, known = MEASURED[side]
    array = run.arrays.get(topic)
    if array is None or not len(array):
        return None
    counts = np.zeros(0, dtype=np.int64)
    for piece in pieces(array):
        ages = piece[field][(piece[known] >= 0) & (piece[field] >= 0) & (piece[field] <= piece["slot"])]  # an answer says its own
        more = np.bincount(ages, minlength=len(counts))
        more[: len(counts)] += counts
        counts = more
    way, symbol = DIRECTIONS[side]
    title, shares = f"{capital(way)}: age of what was used", counts / max(counts.sum(), 1)
    return _shares(title, shares, None, f"{symbol} (samples)", label="measured")


def distribution(view: RunView) -> Section | None:
    """Return the histograms of lateness and round trip and their percentiles; nothing for a run in virtual time."""
    timed, timing = view.run.arrays.get(TIMING.name), view.once(page_summary)["timing"]
    if timed is None or not len(timed):
        return None
    blocks: list[Block] = []
    for field, title, colour in (("lateness_us", "Lateness", 0), ("round_trip_us", "Round trip", 2)):
        histogram = _histogram(whole(timed, field), timing[field], title, colour)
        if histogram is not None:
            blocks.append(histogram)
    columns = ["quantity", "p50", "p99", "p99.9", "max"]
    rows = [
        [name, *(None if (v := timing[field][q]) is None else round(v, 1) for q in ("p50", "p99", "p99_9", "max"))]
        for name, field in (("lateness (µs)", "lateness_us"), ("round trip (µs)", "round_trip_us"))
    ]
    few = "" if len(timed) >= POINTS["p99_9"][1] else f"A p99.9 needs 1000 slots, a p99 100: {len(timed)} show the largest."
    blocks.append(Table(title="Percentiles", columns=columns, rows=rows, note=few))
    counts: list[list[Any]] = [
        ["verdict", "valid" if timing["valid"] else "not valid: " + "; ".join(timing["why"])],
        ["scheduler", timing["scheduler"]],
        ["slots without an answer in time", text_of(timing["late"])],
        ["first of them", "none" if timing["first_late_slot"] is None else f"slot {timing['first_late_slot']}"],
        ["overruns", text_of(timing["overruns"])],
    ]
    blocks.append(Table(title="Slots", columns=["what", "value"], rows=counts))
    return Section(title="Distribution of times", place=70, columns=2, blocks=tuple(blocks))


SECTIONS = (against_laws, distribution)


def _histogram(values: npt.NDArray[np.float64], marks: Mapping[str, float | None], title: str, colour: int) -> Histogram | None:
    finite = values[np.isfinite(values)]
    finite = finite[finite > 0.0]
    if finite.size < 2:
        return None
    low, high = float(finite.min()), float(finite.max())
    wide = high > 20.0 * low
    edges = np.geomspace(low, high * 1.001, BINS + 1) if wide else np.linspace(low, high * 1.001 + 1e-9, BINS + 1)
    names = {"p50": "p50", "p99": "p99", "p99_9": "p99.9"}
    lines = [Marker(x=v, label=f"{names[q]} {text_of(v, 3)}") for q, v in marks.items() if q in names and v is not None]
    return Histogram(
        title=title,
        edges=edges,
        counts=np.histogram(finite, edges)[0],
        markers=tuple(lines),
        x_label=title.lower(),
        x_unit="µs",
        y_label="slots",
        x_log=wide,
        y_log=True,
        colour=colour,
    )
