"""The page of all figures in Markdown, made of what ``python -m tests.bench all --json`` has printed."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any, Final

from tests.bench.figure import Row

HEADS: Final = ("what", "ours", "peer", "ratio", "goal")
WIDTH: Final = 130

TEXT: Final = """\
Made by `python -m tests.bench page` of what `python -m tests.bench all --json` printed: nothing here is typed. A figure and its
peer come from the same run, and only ratios of one run mean anything on a machine that others use too. Less is better
everywhere. A goal is what was aimed at, reached or missed, as a share of the peer: it means the same on any machine. A condition
is what has to hold on any machine. A ratio of few events, as of late answers, is undecided where its 95 % interval holds what was
to be reached. `hil guide performance` says how it is done, and what stands in the way of what was missed.
"""


def page_of(found: dict[str, Any]) -> str:
    """Return the page.

    Args:
        found: what `tests.bench.run_parts.run_parts` returns.
    """
    lines = ["# Figures", "", TEXT, *_wrapped(f"{machine_line(found)}."), "", *_wrapped(_sum(found["figures"])), ""]
    for part in dict.fromkeys(row["part"] for row in found["figures"]):
        rows = [row for row in found["figures"] if row["part"] == part]
        took = f", measured in {found['seconds'][part]:.0f} s" if part in found["seconds"] else ""
        lines += [f"## {part}{took}", "", _line(HEADS), _line(["---", "---:", "---:", "---:", "---"])]
        lines += [*(_line(cells(row)) for row in rows), ""]
        lines += [line for row in rows for line in _wrapped(f"- {remark(row)}")]
        lines.append("")
    return "\n".join(lines).rstrip() + "\n"


def machine_line(found: dict[str, Any]) -> str:
    """Return what the figures were measured on, and when."""
    m = found["machine"]
    quick = ", --quick: nothing is judged" if found["quick"] else ""
    return (
        f"{found['date']}, {m['cpus']} CPUs ({m['cpu']}), {m['memory_gb']:g} GB, {m['system']}, Python {m['python']}, "
        f"load average {m['load_before']:g} before{quick}"
    )


def cells(row: Row) -> tuple[str, ...]:
    """Return a row of the table.

    >>> cells({"name": "a", "ours": 3.0, "peer": 4.0, "ratio": 0.75, "unit": "s", "goal": "2 s", "goal_verdict": "missed",
    ...        "condition": "0.8 times the peer", "condition_verdict": "reached"})
    ('a', '3 s', '4 s', '0.75', 'missed: 2 s; condition holds: 0.8 times')
    """
    judged = []
    if row["goal"] is not None:
        judged.append(f"{row['goal_verdict'].partition(':')[0]}: {row['goal']}")
    if row["condition"] is not None:
        verdict = row["condition_verdict"].partition(":")[0]
        judged.append(f"condition {({'reached': 'holds', 'missed': 'fails'}).get(verdict, verdict)}: {row['condition']}")
    if not judged and row["ours"] is None:
        judged.append("not measured")
    numbers = _number(row["ours"], row["unit"]), _number(row["peer"], row["unit"]), _number(row["ratio"], "")
    return row["name"], *numbers, "; ".join(judged).replace(" the peer", "")


def remark(row: Row) -> str:
    """Return what stands beside a figure, and what else there is to say of it."""
    verdicts = (row["goal_verdict"], row["condition_verdict"] or "")
    why = next((verdict for verdict in verdicts if verdict.startswith("not measured")), "")
    return f"{row['name']}: beside {row['peer_is']}" + "".join(f"; {said}" for said in (row["note"], why) if said)


def _number(value: float | None, unit: str) -> str:
    if value is None:
        return "-"
    return f"{value:.3g} {unit}".strip() if abs(value) < 1000 else f"{value:,.0f} {unit}".strip()


def _sum(rows: Sequence[Row]) -> str:
    """Say how many goals and conditions were reached."""
    told = []
    for key in ("goal", "condition"):
        verdicts = [row[f"{key}_verdict"] for row in rows if row[key] is not None]
        reached, missed = verdicts.count("reached"), verdicts.count("missed")
        open_ = sum(verdict.startswith("undecided") for verdict in verdicts)
        rest = len(verdicts) - reached - missed - open_
        told.append(f"Of {len(verdicts)} {key}s {reached} are reached, {missed} missed, {open_} undecided, {rest} not judged.")
    return " ".join(told)


def _line(values: Sequence[str]) -> str:
    return "| " + " | ".join(value.replace("|", "\\|") for value in values) + " |"


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, subsequent_indent="  " if text.startswith("- ") else "", break_on_hyphens=False)
