"""The page of all figures in Markdown, made of what ``hil bench all --json`` has printed."""

from __future__ import annotations

from typing import Any, Final

from hil.bench.figure import Row

HEADS: Final = ("what", "ours", "peer", "ratio", "goal", "verdict")

TEXT: Final = """\
# Figures

Made by `hil bench page` of what `hil bench all --json` printed: nothing here is typed. Every figure and its peer come from the
same run, and only ratios of one run mean anything on a machine that others use too. Less is better everywhere. A goal is what
was aimed at; a condition is what has to hold on any machine. `hil guide performance` says how it is done, and what stands in the
way of what was missed.
"""


def page_of(found: dict[str, Any]) -> str:
    """Return the page.

    Args:
        found: what `hil.bench.run_parts.run_parts` returns.
    """
    lines = [TEXT, f"{machine_line(found)}.", "", _sum(found["figures"]), ""]
    for part in dict.fromkeys(row["part"] for row in found["figures"]):
        took = f", measured in {found['seconds'][part]:.0f} s" if part in found["seconds"] else ""
        lines += [f"## {part}{took}", "", _line(HEADS), _line(["---"] * len(HEADS))]
        lines += [_line(cells(row)) for row in found["figures"] if row["part"] == part]
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

    >>> cells({"name": "a", "ours": 3.0, "peer": 4.0, "ratio": 0.75, "unit": "s", "peer_is": "C", "note": "twice", "goal": "2 s",
    ...        "goal_verdict": "missed", "condition": None, "condition_verdict": None})
    ('a (twice)', '3 s', '4 s, C', '0.75', '2 s', 'missed')
    """
    goal, verdict = row["goal"] or "-", row["goal_verdict"]
    if row["condition"] is not None:
        said = f"condition {row['condition']}"
        both = row["goal"] is not None
        goal = f"{goal}; {said}" if both else said
        verdict = f"{verdict}; condition {row['condition_verdict']}" if both else row["condition_verdict"]
    return (
        row["name"] + (f" ({row['note']})" if row["note"] else ""),
        _number(row["ours"], row["unit"]),
        f"{_number(row['peer'], row['unit'])}, {row['peer_is']}",
        _number(row["ratio"], ""),
        goal,
        verdict,
    )


def _number(value: float | None, unit: str) -> str:
    return "-" if value is None else f"{value:.3g} {unit}".strip() if abs(value) < 1000 else f"{value:,.0f} {unit}".strip()


def _sum(rows: list[Row]) -> str:
    """Say how many goals and conditions were reached."""
    told = []
    for key in ("goal", "condition"):
        verdicts = [row[f"{key}_verdict"] for row in rows if row[key] is not None]
        reached, missed = verdicts.count("reached"), verdicts.count("missed")
        rest = len(verdicts) - reached - missed
        told.append(f"Of {len(verdicts)} {key}s {reached} are reached, {missed} missed, {rest} not judged.")
    return " ".join(told)


def _line(values: tuple[str, ...] | list[str]) -> str:
    return "| " + " | ".join(value.replace("|", "\\|") for value in values) + " |"
