"""A fitted network law as the file that an experiment includes: the law, and beside it what it leans on."""

from __future__ import annotations

from typing import Any

from hil.files.toml_text import toml_lines
from transport.law_fit import LawFit
from transport.law_fit.proportions import LAGS, POWER, REJECT, arrivals, seen_correlations

WORDS = {
    "constant": "a constant latency",
    "independent": "independent latencies",
    "gilbert-elliott": "independent latencies, and losses in bursts (Gilbert-Elliott)",
    "markov": "ages that are a Markov chain",
    "semi-markov": "ages that are a semi-Markov chain",
    "none": "none of the laws",
}


def fit_said(fit: LawFit, way: str, source: str, notes: tuple[str, ...]) -> dict[str, Any]:
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
        said["comes_at_age"] = [[share, *pair] for share, pair in arrivals(fit).shares()]
        said["intervals"] = {name: list(pair) for name, pair in fit.losses.intervals.items()}
    said["tried"] = [{"name": c.name, "fitted_to": c.fitted_to, "parameters": c.parameters, "bic": c.bic} for c in fit.candidates]
    return said


def independence_said(fit: LawFit) -> tuple[str, ...]:
    """Return what the test of independence says, in words: of latencies and losses, and of slots where it is rejected.

    Where it is not, its power is said: which correlations it would have found.
    """
    tested = fit.tested
    if tested.independent:
        seen = seen_correlations(len(fit.record.sent_s))
        power = f"; one of {seen.neighbours:.2g} of neighbours, or of {seen.apart:.2g} further apart, would be found in "
        power += f"{100.0 * POWER:g} % of such records, and a smaller one is often missed"
    else:
        power = ""
    rejected = "not rejected" if tested.independent else "rejected"
    said = (
        f"independence of latencies and losses is {rejected}: p = {tested.independence:.2g}, level {REJECT:g} (neighbours "
        f"{tested.neighbours:.2g}, up to {LAGS} packets apart {tested.lags:.2g}; the largest correlation is "
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
        said: from `fit_said`.
    """
    head = f"# {WORDS[fit.law_class]}: {said['packets']} packets of {' '.join(said['source'].split())} ({said['way']})\n"
    head += '# In an experiment: law = { file = "NAME.toml" }\n'
    rows = toml_lines({key: value for key, value in said.items() if key != "tried"})
    tried = "".join(f"\n[[fit.tried]]\n{toml_lines(each)}" for each in said["tried"])
    return f"{head}\n{toml_lines(fit.spec)}\n[fit]\n{rows}{tried}"
