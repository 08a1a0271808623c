"""The page of all figures in Markdown, made of what ``python -m tests.bench all --json`` has printed."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any, Final

from tests.bench.figure import Row, judged

HEADS: Final = ("what", "interpreted", "ratio", "compiled", "ratio", "goal")
WIDTH: Final = 130

TEXT: Final = """\
Made by `python -m tests.bench page` of what `python -m tests.bench all --json` printed: nothing here is typed. A figure and its
peer come from the same run, and only ratios of one run mean anything on a machine that others use too: `ratio` is that to the
peer, which stands below the table. Less is better everywhere. What runs slots is measured interpreted and compiled, one after
the other, each beside a peer of its own; the compiled form is judged where it was measured, and the verdict of the interpreted
one stands below the table where it is another. A goal is what was aimed at, reached or missed, as a share of the peer: it means
the same on any machine. A condition is what has to hold on any machine. A ratio of few events, as of late answers, is undecided
where its 95 % interval holds what was to be reached. `hil guide performance` says how it is done, and what stands in the way of
what was missed.
"""


def page_of(machines: Sequence[dict[str, Any]]) -> str:
    """Return the page: one section for each machine.

    Args:
        machines: of each what `tests.bench.run_parts.run_parts` returns.
    """
    lines = ["# Figures", "", TEXT, *(line for found in machines for line in section_of(found))]
    return "\n".join(lines).rstrip() + "\n"


def section_of(found: dict[str, Any]) -> list[str]:
    """Return the lines of one machine."""
    lines = [f"## {found['machine']['cpu']}", "", *_wrapped(f"{machine_line(found)}."), ""]
    lines += [*_wrapped(_sum(found["figures"])), ""]
    for part in dict.fromkeys(row["part"] for row in found["figures"]):
        rows = [row for row in found["figures"] if row["part"] == part]
        took = f", measured in {found['seconds'][part]:.0f} s" if part in found["seconds"] else ""
        lines += [f"### {part}{took}", "", _line(HEADS), _line(["---", *["---:"] * 4, "---"])]
        lines += [*(_line(cells(row)) for row in rows), ""]
        lines += [line for row in rows for line in _wrapped(f"- {remark(row)}")]
        lines.append("")
    return lines


def machine_line(found: dict[str, Any]) -> str:
    """Return what the figures were measured on, and when."""
    m = found["machine"]
    quick = ", --quick: nothing is judged" if found["quick"] else ""
    return (
        f"{found['date']}, {m['cpus']} CPUs ({m['cpu']}), {m['memory_gb']:g} GB, {m['system']}, Python {m['python']}, "
        f"load average {m['load_before']:g} before{quick}"
    )


def cells(row: Row) -> tuple[str, ...]:
    """Return a row of the table; verdicts are those of what is judged.

    >>> numbers = {"ours": 3.0, "ratio": 0.75, "goal_verdict": "missed", "condition_verdict": "reached"}
    >>> whole = {"name": "a", "unit": "s", "goal": "2 times the peer", "condition": "0.8 times the peer", **numbers}
    >>> cells(whole)
    ('a', '3 s', '0.75', '', '', 'missed: 2 times; condition holds: 0.8 times')
    >>> cells(whole | {"compiled": numbers | {"ours": 2.0, "ratio": 0.5, "goal_verdict": "reached"}})[1:]
    ('3 s', '0.75', '2 s', '0.5', 'reached: 2 times; condition holds: 0.8 times')
    """
    verdicts = _verdicts(judged(row))
    texts = [f"{said}: {row[key]}" for key, said in verdicts.items() if row[key] is not None]
    if not texts and judged(row)["ours"] is None:
        texts.append("not measured")
    compiled = row.get("compiled")
    second = ("", "") if compiled is None else (_number(compiled["ours"], row["unit"]), _number(compiled["ratio"], ""))
    numbers = _number(row["ours"], row["unit"]), _number(row["ratio"], "")
    return row["name"], *numbers, *second, "; ".join(texts).replace(" the peer", "")


def _verdicts(numbers: Row) -> dict[str, str]:
    goal, condition = (str(numbers[f"{key}_verdict"]).partition(":")[0] for key in ("goal", "condition"))
    return {"goal": goal, "condition": f"condition {({'reached': 'holds', 'missed': 'fails'}).get(condition, condition)}"}


def remark(row: Row) -> str:
    """Return what stands beside a figure, and what else there is to say of it."""
    text = f"{row['name']}: beside {row['peer_is']}{_said(row, row['unit'])}"
    compiled = row.get("compiled")
    if compiled is None:
        return text
    own, other = _verdicts(row), _verdicts(compiled)
    text += "".join(f"; {own[key]}" for key in own if row[key] is not None and own[key] != other[key])
    return f"{text}; compiled{_said(compiled, row['unit'])}"


def _said(numbers: Row, unit: str) -> str:
    peer = [] if numbers["peer"] is None else [_number(numbers["peer"], unit)]
    verdicts = (numbers["goal_verdict"], numbers["condition_verdict"] or "")
    why = next((verdict for verdict in verdicts if verdict.startswith("not measured")), "")
    said = "; ".join([*peer, *(text for text in (numbers["note"], why) if text)])
    return f", {said}" if said else ""


def _number(value: float | None, unit: str) -> str:
    if value is None:
        return "-"
    return f"{value:.3g} {unit}".strip() if abs(value) < 1000 else f"{value:,.0f} {unit}".strip()


def _sum(rows: Sequence[Row]) -> str:
    """Say how many goals and conditions were reached."""
    counts = []
    for key in ("goal", "condition"):
        verdicts = [judged(row)[f"{key}_verdict"] for row in rows if row[key] is not None]
        reached, missed = verdicts.count("reached"), verdicts.count("missed")
        open_ = sum(verdict.startswith("undecided") for verdict in verdicts)
        rest = len(verdicts) - reached - missed - open_
        counts.append(f"Of {len(verdicts)} {key}s {reached} are reached, {missed} missed, {open_} undecided, {rest} not judged.")
    return " ".join(counts)


def _line(values: Sequence[str]) -> str:
    return "| " + " | ".join(value.replace("|", "\\|") for value in values) + " |"


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, subsequent_indent="  " if text.startswith("- ") else "", break_on_hyphens=False)
