"""Recorded packets, from our logs and from those of others: when each was sent, when it came, and what clocks did to that.

Here are the packets that a file records, before a law is fitted, by direction; and the network law that was fitted to them, as
the file that an experiment includes, with what it leans on.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from hil.errors import HilError, located
from hil.files.toml_text import toml_lines
from transport.errors import FieldError
from transport.law_fit import LawFit
from transport.law_fit.packet_record import Drift, PacketRecord, drift_and_rise, drift_of, offset_of, without_drift
from transport.law_fit.proportions import POWER, REJECT, arrivals, lags_tested, seen_correlations

Array = NDArray[np.float64]

ROUND_TRIP: Final = "round trip"
THERE, BACK = "sc", "ca"


class Way(Struct, frozen=True, kw_only=True, eq=False):
    """Packets of one direction.

    Args:
        sent_s: (n,) instants at the sender's clock.
        difference_s: (n,) received, at the receiver's clock, minus sent; NaN of what did not come.
        until_s: see `transport.law_fit.packet_record.PacketRecord`; None: what did not come was lost.
    """

    sent_s: Array
    difference_s: Array
    until_s: Array | None = None


class Recording(Struct, frozen=True, kw_only=True, eq=False):
    """What one or two files hold.

    Args:
        source: the files, for messages.
        ways: "sc", "ca" or "round trip" to its packets.
        clocks: clocks that took the time stamps: 1, or 2 that may run apart; 0 where none says when packets were sent.
        notes: what the reader found worth a line.
    """

    source: str
    ways: Mapping[str, Way]
    clocks: int
    notes: tuple[str, ...] = ()


def packet_records(recording: Recording, *, halve: bool = False) -> tuple[dict[str, PacketRecord], tuple[str, ...]]:
    """Return latencies by direction, with what was done about clocks, in words.

    Args:
        recording: what was read.
        halve: take half of a round trip for each direction.

    Raises:
        HilError: latencies are negative, time stamps run backwards, or there are too few packets; the message has the remedy.
    """
    ways, notes = dict(recording.ways), list(recording.notes)
    if recording.clocks == 2:
        drifts = {name: _drift(way) for name, way in ways.items()}
        if THERE in ways and BACK in ways:
            drift, rise = drift_and_rise(drifts[THERE], drifts[BACK])
            drifts = {THERE: drift, BACK: drift._replace(slope=-drift.slope)}
            if rise.seen:
                size = f"{rise.slope * 1e6:.3g} us per s (95 %: +- {rise.half_width * 1e6:.2g})"
                notes.append(
                    f"the least latency rises by {size} in the mean of both directions, which no clock does: it stays in, and a "
                    "drift is distinguished from it if it is the same in both"
                )
        for name, way in ways.items():
            ways[name] = _straight(name, way, drifts[name], notes)
        if THERE in ways and BACK in ways:
            offset = offset_of(ways[THERE].difference_s, ways[BACK].difference_s)
            shifts = {THERE: -offset, BACK: offset}
            ways = {name: replace(way, difference_s=way.difference_s + shifts[name]) for name, way in ways.items()}
            notes.append(f"offset between the clocks {offset:.6g} s, taken out: the least latency is the same in both directions")
        else:
            said = "would shift every latency, and cannot be seen; a latency that grows would be taken for a drift"
            notes.append(f"one direction: an offset between the two clocks {said}")
    if halve:
        if ROUND_TRIP not in ways:
            raise HilError(f"{recording.source}: --halve: these are no round trips, but {' and '.join(ways)}")
        whole = ways.pop(ROUND_TRIP)
        ways |= {name: Way(sent_s=whole.sent_s, difference_s=whole.difference_s / 2.0) for name in (THERE, BACK)}
        notes.append("each direction is half of a round trip, by choice: that they are equal, and independent, is assumed")
    found = {}
    for name, way in ways.items():
        with located(f"{recording.source}: {name}", FieldError):
            found[name] = PacketRecord(sent_s=way.sent_s, latency_s=way.difference_s, until_s=way.until_s)
    return found, tuple(notes)


def _drift(way: Way) -> Drift:
    """Return the drift in one direction, none where too few packets came."""
    none = len(way.sent_s) < 2 or np.isnan(way.difference_s).all()
    return Drift(0.0, np.inf, False) if none else drift_of(way.sent_s, way.difference_s)


def _straight(name: str, way: Way, drift: Drift, notes: list[str]) -> Way:
    if not np.isfinite(drift.half_width):
        return way
    said = f"{name}: drift between the clocks {drift.slope * 1e6:.3g} ppm (95 %: +- {drift.half_width * 1e6:.2g})"
    notes.append(f"{said}, taken out" if drift.seen else f"{said}: none is seen, none is taken out")
    if not drift.seen:
        return way
    return replace(way, difference_s=without_drift(way.sent_s, way.difference_s, drift))


WORDS = {
    "constant": "a constant latency",
    "independent": "independent latencies",
    "gilbert-elliott": "independent latencies, and losses in bursts (Gilbert-Elliott)",
    "markov": "ages that are a Markov chain",
    "semi-markov": "ages that are a semi-Markov chain",
    "none": "none of the laws",
}


def class_text(fit: LawFit) -> str:
    """Return the class of a fitted law in words. Where a test rejects independent latencies, the class holds for slots only."""
    in_slots = fit.law_class in ("constant", "independent", "gilbert-elliott") and not fit.tested.independent
    return WORDS[fit.law_class] + (", as far as slots show" if in_slots else "")


def latencies_text(fit: LawFit) -> str:
    """Return the fitted latencies in words: family and parameters, whether the shape fits, and what was measured."""
    name, spec, came = fit.latencies.name, fit.latencies.spec, fit.record.latency_s[fit.record.came]
    values = [
        f"{key} = {f'{1e3 * value:.4g} ms' if key in ('loc', 'scale') else f'{value:.4g}'}"
        for key, value in (spec.items() if isinstance(spec, dict) else ())
        if isinstance(value, float)
    ]
    shape = "as measured" if name in ("table", "constant") else f"shape p = {fit.tested.shape:.2g}"
    mean, late = 1e3 * came.mean(), 1e3 * np.quantile(came, 0.99)
    return f"latencies: {name} ({', '.join([*values, shape])}); measured: {mean:.4g} ms on average, 99 % within {late:.4g} ms"


def fitted_value(fit: LawFit, name: str) -> float:
    """Return a parameter of a fitted law by the name of its interval: ``loss``, or ``matrix[1][0]`` of ages."""
    place = re.fullmatch(r"matrix\[(\d+)\]\[(\d+)\]", name)
    if fit.ages is None or place is None:
        return fit.losses.values[name]
    return float(fit.spec["matrix"][int(place[1])][int(place[2])])


def fit_document(fit: LawFit, way: str, source: str, notes: tuple[str, ...]) -> dict[str, Any]:
    """Return what was found of one direction as plain values.

    Args:
        fit: of it.
        way: "sc", "ca" or "round trip".
        source: the files.
        notes: what was done about clocks.
    """
    tested, record = fit.tested, fit.record
    said: dict[str, Any] = {
        "source": source, "way": way, "class": fit.law_class, "packets": len(record.sent_s), "lost": int((~record.came).sum()),
        "period_s": fit.period_s, "deadline_s": fit.deadline_s, "distribution": fit.latencies.name,
        "p_independent": tested.independence, "p_neighbours": tested.neighbours, "p_lags": tested.lags,
        "largest_correlation": tested.largest,
        "at_lag": tested.largest_lag, "would_see": list(seen_correlations(len(record.sent_s))),
        "p_slots": fit.in_slots, "p_shape": tested.shape,
        "notes": list(notes),
    }  # fmt: skip
    if fit.ages is not None:
        said["intervals"] = {name: list(pair) for name, pair in fit.ages.intervals.items()}
    else:
        said["comes_at_age"] = [[share, *(pair or ())] for share, pair in arrivals(fit).shares()]
        said["intervals"] = {name: list(pair) for name, pair in fit.losses.intervals.items()}
    said["tried"] = [{"name": c.name, "fitted_to": c.fitted_to, "parameters": c.parameters, "bic": c.bic} for c in fit.candidates]
    return said


def independence_text(fit: LawFit) -> tuple[str, ...]:
    """Return what the test of independence says, in words: of latencies and losses, and of slots where it is rejected.

    Where it is not, its power is said: which correlations it would have found.
    """
    tested, packets = fit.tested, len(fit.record.sent_s)
    if tested.independent:
        seen = seen_correlations(packets)
        power = f"; one of {seen.neighbours:.2g} of neighbours, or of {seen.apart:.2g} further apart, would be found in "
        power += f"{100.0 * POWER:g} % of such records, and a smaller one is often missed"
    else:
        power = ""
    rejected = "not rejected" if tested.independent else "rejected"
    said = (
        f"independence of latencies and losses is {rejected}: p = {tested.independence:.2g}, level {REJECT:g} (neighbours "
        f"{tested.neighbours:.2g}, up to {lags_tested(packets)} packets apart {tested.lags:.2g}; the largest correlation is "
        f"{tested.largest:.2g}, {tested.largest_lag} apart{power})"
    )
    if tested.independent or fit.law_class == "none" or fit.ages is not None:
        return (said,)
    return said, (
        f"independence of the slots of {fit.period_s * 1e3:g} ms in which packets come is not rejected (p = {fit.in_slots:.2g}), "
        "and a loop sees no more"
    )


def law_text(fit: LawFit, said: dict[str, Any]) -> str:
    """Return the file of a law.

    Args:
        fit: what was fitted.
        said: from `fit_document`.
    """
    head = f"# {class_text(fit)}: {said['packets']} packets of {' '.join(said['source'].split())} ({said['way']})\n"
    head += '# In an experiment: law = { file = "NAME.toml" }\n'
    rows = toml_lines({key: value for key, value in said.items() if key != "tried"})
    tried = "".join(f"\n[[fit.tried]]\n{toml_lines(each)}" for each in said["tried"])
    return f"{head}\n{toml_lines(fit.spec)}\n[fit]\n{rows}{tried}"
