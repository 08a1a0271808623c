"""Chapters 2, 4 and 7, row by row: a number that decides is changed, and the verdict of its row turns, and no other one.

Each row is fed with numbers at which it stands, near its limits; where its print does not hold, with such at which it would.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from string import Formatter
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hil.thesis import Stage, Statement
from hil.thesis.chapter7_designs import NAME, NAMES, SERIES
from hil.thesis.chapter7_friction import EXPERIMENT, STEADY
from hil.thesis.chapter7_friction import NAMES as CONTROLLERS
from hil.thesis.chapter7_models import EIGENVALUES
from hil.thesis.chapter7_runs import TABLE_7_1, TABLE_7_2, UNKNOWN
from hil.thesis.statements import judge

Numbers = dict[str, Any]
Turns = list[tuple[Numbers, str]]
Table = dict[str, tuple[str, Numbers, Turns]]
"""By the begin of a row's item: its verdict, its numbers, and changes with the verdict that each leads to."""

OK, FALSE, NOT, OPEN = "reproduced", "claim false", "not reproduced", "undecided"


def holds(right: Numbers, wrong: Numbers, verdict: str = NOT, **more: Any) -> tuple[str, Numbers, Turns]:
    """A row without witness: each number alone, when wrong, turns it; ``more`` are limits."""
    return OK, {**right, **more}, [({name: value}, OPEN if value is OPEN else verdict) for name, value in wrong.items()]


def runs(printed: str, size: float = 1.0) -> np.ndarray:
    """Runs, of which the printed one is the middle."""
    return size * float(printed) * np.linspace(0.9, 1.1, 401)


# fmt: off
CHAPTER_2: Table = {
    "Theorem 2.4 (M = 1)": (FALSE, {"single": "feasible", "proved": 1, "pivot": 0.5, "sections": 1}, [
        ({"single": "refused"}, OK), ({"proved": 0}, NOT), ({"pivot": -1.0}, NOT), ({"sections": 2}, NOT)]),
    "the same with the F that": holds({"matched": "refused"}, {"matched": "feasible"}),
    "gains (2.27) fulfil": holds({"published.verdict": "certified"}, {"published.verdict": "refused"}),
    "gains (2.27) stabilise under": holds(
        {"linear.verdict": "certified", "linear.decay_rate": 0.49}, {"linear.verdict": OPEN, "linear.decay_rate": -0.1}),
    **{f"M = 4 yields a feasible solution, while M = 2 does not, for certain systems, by {form}": holds(
        {f"forms[{form}][0]": "refused", f"forms[{form}][1]": "feasible"},
        {f"forms[{form}][0]": "feasible", f"forms[{form}][1]": OPEN})
       for form in ("the printed form", "the sound form, linear in h")},
    "computation time": (OPEN, {"seconds": 0.02, "gains.verdict": "certified"}, [
        ({"seconds": 60.0}, OPEN), ({"gains.verdict": "refused"}, NOT)]),
    "(2.27): the gains": holds({"off": 4e-5}, {"off": 6e-5}, size=22.0),
    **{item: (FALSE, {f"growth[{n}]": high, f"accepted[{n}].verdict": "certified"}, [
        ({f"growth[{n}]": low}, OK), ({f"accepted[{n}].verdict": "refused"}, NOT)])
       for n, (item, high, low) in enumerate((
           ("Corollary 2.1 is sufficient for stability (hazard", 5.46, 0.9),
           ("Corollary 2.1 is sufficient for stability (the thesis's", 1.107, 0.9), ("Theorem 2.2 covers", 0.99, -0.1)))},
    "gains (2.27) stabilise the example": (OK, {"ours[worst]": 0.44, "ours[always]": "certified"}, [
        ({"ours[worst]": 1.01}, FALSE), ({"ours[always]": OPEN}, OPEN)]),
    "gains [1, 2] stabilise": (FALSE, {"other[worst]": 1.52, "other[always]": "refused"}, [
        ({"other[worst]": 0.99}, NOT), ({"other[worst]": 0.99, "other[always]": "certified"}, OK)]),
    "Weibull, scale 1": (FALSE, {"rate[0]": 0.2, "rate[1]": 9.2}, [
        ({"rate[0]": 0.1, "rate[1]": 4.6}, OK), ({"rate[0]": 0.1}, NOT), ({"rate[1]": 4.6}, NOT)]),
    "Pr{0.1 <= h": holds({"plain": 0.995, "doubled": 0.9901}, {"plain": 0.9899, "doubled": 0.9899}),
    "h = 0.8326": holds({"median[1]": 0.83256}, {"median[1]": 0.83254}),
    **{f"settling time (2.28) of {item}": holds(
        {f"mean[{who}]": mean, f"sd[{who}]": sd}, {f"mean[{who}]": 1.02 * mean, f"sd[{who}]": 1.06 * sd},
        **{f"mean_error[{who}]": 0.004 * mean, f"sd_error[{who}]": 0.01 * sd})
       for who, item, mean, sd in (("ours", "(2.27)", 3.5741, 0.8849), ("other", "[1, 2]", 9.91, 2.1895))},
    "Figure 2.2a: one run": holds({"times[ours]": runs("2.95")}, {"times[ours]": runs("2.95", 2.0)}),
    "Figure 2.2a: the same run": holds({"late": 0.44}, {"late": 0.004}),
    "(2.27) settles faster": holds({"ahead": 0.1}, {"ahead": -0.1}),
    **{f"Table 2.1, +-{k + 1}": holds(
        {f"away[ours][{k}]": size}, {f"away[ours][{k}]": 1.05 * size}, **{f"both[ours][{k}]": 0.01 * size})
       for k, size in enumerate((0.87, 1.75, 3.03))},
    "in the emulated loop (2.27)": holds({"ahead[published]": 0.1}, {"ahead[published]": -0.1}),
    "in the emulated loop our": holds({"ahead[ours]": 0.1}, {"ahead[ours]": -0.1}),
    "partitioning reduces": holds({"least[pwl]": 0.18, "least[pwc]": 0.03}, {"least[pwl]": 0.001, "least[pwc]": 0.001}),
    "the partition strategy": (
        OPEN, {"pwc[role]": 1.05, "pwl[role]": 1.32}, [({"pwc[role]": 1.2}, OK), ({"pwl[role]": 1.09}, NOT)]),
    "8.1: control": holds(
        {"semi[0]": 0.9, "semi[1]": 1.12, "semi[2]": 1.68}, {"semi[0]": 0.6, "semi[1]": 0.9, "semi[2]": -2.0},
        **{"markov[0]": 0.66, "markov[1]": 0.92, "markov[2]": -1.0}),
}
CHAPTER_4: Table = {
    "gains (4.30) fulfil": holds(
        {"single.verdict": "certified", "single.gamma": 0.062}, {"single.verdict": "refused", "single.gamma": 1.51}),
    "gains (4.31) fulfil": holds(
        {f"{of}.verdict": "certified" for of in ("parts[0]", "parts[1]", "sound")}
        | {"parts[0].gamma": 0.021, "parts[1].gamma": 0.147, "sound.gamma": 0.018},
        {f"{of}.{what}": wrong for of in ("parts[0]", "parts[1]", "sound")
         for what, wrong in (("verdict", OPEN), ("gamma", 1.51))}),
    "u = K(r, h) x with (4.30)": (FALSE, {"by_r.verdict": "refused", "growth": 0.1, "undetected": 0.1}, [
        ({"by_r.verdict": "certified"}, OK), ({"by_r.verdict": OPEN}, OPEN), ({"growth": -0.1}, NOT),
        ({"undetected": -0.1}, NOT)]),
    "u = K(r, h) x with (4.31)": holds(
        {"by_r_parts.verdict": "certified", "by_r_parts.gamma": 0.016},
        {"by_r_parts.verdict": "refused", "by_r_parts.gamma": 1.51}),
    "Corollary 4.3 is": (FALSE, {"pairs[0]": "certified", "pairs[1]": "certified", "pair_growth": 0.2}, [
        ({"pairs[0]": "refused"}, NOT), ({"pairs[1]": "refused"}, NOT), ({"pair_growth": -0.1}, OK)]),
    "sections meet": (FALSE, {"away": 0.67, "away_s": 4e-4, "smallest": 0.118}, [({"away": 4e-4}, OK), ({"away_s": 6e-4}, NOT)]),
    "the partition needs": holds({"grown": 0.91}, {"grown": 1.01}),
    **{f"||y|| / ||w||, gains {item}": (OK, {f"ratio[{n}][{k}]": runs(p) for k in (0, 1)}, [
        ({f"ratio[{n}][0]": runs(p, 2.0)}, OPEN), ({f"ratio[{n}][1]": runs(p, 0.5)}, OPEN),
        ({f"ratio[{n}][{k}]": runs(p, 0.5) for k in (0, 1)}, NOT)])
       for n, (item, p) in enumerate((("(4.30)", "0.4606"), ("(4.31)", "0.3093")))},
    "the ratio is below": holds({"largest[0]": 0.18, "largest[1]": 0.15}, {"largest[0]": 1.51, "largest[1]": 1.51}),
    "the partition reduces ||y|| for": holds({"surely": -0.04}, {"surely": 0.01}),
    "overshoot of y": holds({"over[1]": 0.0}, {"over[1]": 0.19}, half=0.186),
    "(4.30): the gains": holds(
        {"single[2].verdict": "certified", "off[2][0]": 4e-5}, {"single[2].verdict": OPEN, "off[2][0]": 6e-5},
        **{"size[0]": 29.0}),
    "(4.31): the gains": holds(
        {"parts[2][0].verdict": "certified", "parts[2][1].verdict": "certified", "off[2][1]": 4e-5},
        {"parts[2][0].verdict": "refused", "parts[2][1].verdict": "refused", "off[2][1]": 6e-5}, **{"size[1]": 26.0}),
    "Remark 4.5": holds({f"share[{n}]": 1.4 for n in range(3)}, {f"share[{n}]": 1.0 for n in range(3)}, OPEN),
    "Remark 4.6": holds({f"less[{n}]": -0.004 for n in range(3)}, {f"less[{n}]": 3e-4 for n in range(3)}, OPEN),
    "Remark 4.1: a lost sensor": holds(
        {"A": 0.0, "B": 0.0, "E": 0.0, "lost": 1.0, "ours.verdict": "certified", "growth": -0.07, "loop": "certified"},
        {"A": 1e-3, "B": 1.77, "E": 0.1, "lost": 0.0, "ours.verdict": OPEN, "growth": 0.01, "loop": "refused"}),
    "Remark 4.1: gains that know": holds({"ours.gamma": 0.021}, {"ours.gamma": 0.023, "unaware": 0.02}, unaware=0.022),
    "Remark 4.1: a fault of": holds(
        {"same": 0.0, "E": 0.2, "rough.verdict": "certified", "growth": -0.05, "rough.gamma": 0.0168},
        {"same": 1.77, "E": 0.0, "rough.verdict": OPEN, "growth": 0.01, "rough.gamma": 0.005}, **{"calm.gamma": 0.0054}),
    "4.2: a Markov": holds({"over.verdict": "certified"}, {"over.verdict": OPEN}),
    "Remark 4.4": holds({"above": "certified", "below": "refused"}, {"above": OPEN, "below": "certified"}),
    "(4.6) with": holds({"general.verdict": "certified", "margin": 0.15}, {"general.verdict": OPEN, "margin": -1e-3}),
}
PRINTED = {("motor", "hinf"): 17.4085, ("motor", "h2"): 5.0147, ("vtol", "h2"): 0.1225, ("vtol", "hinf"): 0.3464}
SYMBOLS = {"h2": "beta_min", "hinf": "gamma_min"}
CHAPTER_7: Table = {
    "motor: A, B": (
        OK, {"eigenvalues[0]": 0.838253, "smaller": 0.838253, "eigenvalues[1]": 1.0, "response[0]": 0.203342, "hold[0]": 0.203342,
             "response[1]": 0.565526, "hold[1]": 0.565526},
        [({"eigenvalues[0]": 0.83826}, NOT), ({"eigenvalues[1]": 0.99977}, NOT), ({"response[0]": 0.34868}, NOT),
         ({"response[1]": 0.384084}, NOT), ({"eigenvalues[1]": 1.00023}, FALSE)]),
    "VTOL: A, B": holds({"off": 4.98e-5}, {"off": 5.1e-5}, entry=1.0),
    "VTOL: eigenvalues": holds(
        {f"pair[{n}].{part}": value for n, both in enumerate(EIGENVALUES) for part, value in zip(("real", "imag"), both)},
        {f"pair[{n}].{part}": value + 6e-5 for n, both in enumerate(EIGENVALUES) for part, value in zip(("real", "imag"), both)}),
    "Remark 7.5": (FALSE, {"change[1]": 0.1, "valid": 0.1, "greater": 0.1}, [
        ({"change[1]": -0.1}, OK), ({"valid": -0.1}, NOT), ({"greater": -0.1}, NOT)]),
    "(7.19)": (FALSE, {"energy": 3.7368, "mean": 3.647, "errors[0]": 0.75, "errors[1]": 16.0}, [
        ({"energy": 3.647}, OK), ({"errors[0]": -5.0}, NOT), ({"errors[1]": 3.0}, NOT)]),
    "(7.35)": holds({"bytes": 20, "frames": 1}, {"bytes": 36, "frames": 2}),
    **{f"{NAME[name]}: the published gains have the norm {SYMBOLS[of]}": holds(
        {f"{name}_{of}[norm]": printed}, {f"{name}_{of}[norm]": printed + 7e-5}, **{f"{name}_{of}[rounding]": 1e-5})
       for (name, of), printed in PRINTED.items()},
    **{f"{NAME[name]}: {SYMBOLS[of]} is": (OK, {f"{name}_{of}[least]": 1.0}, [
        ({f"{name}_{of}[least]": 0.98}, FALSE if name == "vtol" else NOT), ({f"{name}_{of}[least]": 1.1}, NOT)])
       for name, of in PRINTED},
    **{f"motor: {NAMES[of]} gains": holds(
        {f"motor_{of}_sum[off]": 4e-5}, {f"motor_{of}_sum[off]": 6e-5}, **{f"motor_{of}[size]": 0.2}) for of in NAMES},
    **{f"VTOL: {NAMES[of]} gain K({tau},{d})": holds(
        {f"vtol_{of}_sum[each][{tau}][{d}]": 4e-5}, {f"vtol_{of}_sum[each][{tau}][{d}]": 6e-5}, **{f"vtol_{of}[size]": 5.6})
       for of in NAMES for tau in range(3) for d in range(2)},
    **{f"{NAME[name]}: time": (OPEN, {f"seconds[{name}]": 1.0}, [({f"seconds[{name}]": 7000.0}, OPEN)]) for name in NAME},
    "motor: (7.36) and (7.37)": holds({"radii[0]": 0.9, "radii[1]": 0.92}, {"radii[0]": 1.01, "radii[1]": 1.01}),
    "motor: local": holds({"gain": -0.4515}, {"gain": -0.4516}),
    "motor: the local gain": (FALSE, {"over[0]": 1.05, "over[1]": 0.98}, [({"over[0]": 0.99}, OK), ({"over[1]": 1.01}, NOT)]),
    "VTOL: the local gain": (FALSE, {"vertical": 1.22}, [({"vertical": 0.99}, OK)]),
    "VTOL: [-56.0196": (FALSE, {"excess[h2]": 0.32}, [({"excess[h2]": 0.001}, OK)]),
    "VTOL: the labels": holds(
        {"labels[0][0]": 0.122, "labels[1][1]": 0.339}, {"labels[0][0]": 0.128, "labels[1][1]": 0.41},
        **{"labels[1][0]": 0.127, "labels[0][1]": 0.405}),
    **{f"Table 7.1, {name}": (OK, {f"{name}[sums][{k}]": runs(p) for k in (0, 1)}, [
        ({f"{name}[sums][0]": runs(p, 2.0)}, OPEN), ({f"{name}[sums][1]": runs(p, 2.0)}, OPEN),
        ({f"{name}[sums][{k}]": runs(p, 2.0) for k in (0, 1)}, NOT)])
       for name, (_, _, p) in TABLE_7_1.items() if name != UNKNOWN},
    f"Table 7.1, {UNKNOWN}": (OPEN, {f"{UNKNOWN}[radius]": 1.22}, [({f"{UNKNOWN}[radius]": 0.9}, OPEN)]),
    **{f"Table 7.2, simulation, {name}": holds(
        {f"{name}_0[sums][{k}]": runs(p) for k, p in enumerate(each)},
        {f"{name}_0[sums][{k}]": runs(p, 0.5) for k, p in enumerate(each)}, **{f"{name}_0[runs]": 401})
       for name, each in TABLE_7_2.items()},
    "Figure 7.4": holds(
        {f"{gain}[{side}][{n}][{k}]": sign for gain in ("cautious", "bold") for n in (0, 1)
         for side, k, sign in (("less", 1, -4.0), ("more", 0, 1.4), ("more", 2, 0.08))},
        {f"{gain}[{side}][{n}][{k}]": -sign for gain in ("cautious", "bold") for n in (0, 1)
         for side, k, sign in (("less", 1, -4.0), ("more", 0, 1.4), ("more", 2, 0.08))}, OPEN),
    "the same for every Smith": (
        FALSE, {"every[0]": -0.96, "every[2]": -0.02} | {f"bold[less][0][{k}]": -0.01 for k in range(3)},
        [({f"bold[less][0][{k}]": 0.01}, NOT) for k in range(3)]
        + [({"every[0]": 0.1, "every[2]": 0.1}, OK), ({"every[0]": 0.1, "bold[less][0][0]": 0.01}, NOT),
           ({"every[2]": 0.1, "bold[less][0][0]": 0.01}, NOT)]),
    **{f"Table 7.2, experiment, {CONTROLLERS[name]}": holds(
        {f"{name}[runs][{k}]": runs(p) for k, p in enumerate(each)},
        {f"{name}[runs][{k}]": runs(p, 2.0) for k, p in enumerate(each)}, seeds=401) for name, each in EXPERIMENT.items()},
    **{f"Remark 7.7: steady-state error, {CONTROLLERS[name]}": holds(
        {f"{name}[runs][2]": runs(p)}, {f"{name}[runs][2]": runs(p, -1.0)}, seeds=401) for name, p in STEADY.items()},
    **{f"{NAME[name]}, {NAMES[of]}: the row": (OK, {f"{name}_{of}[before]": -0.007}, [
        ({f"{name}_{of}[before]": 2e-4}, FALSE), ({f"{name}_{of}[before]": -1e-5}, NOT)]) for name, of in SERIES},
    **{f"{NAME[name]}, {NAMES[of]}: gains that": holds(
        {f"{name}_{of}[one]": -0.02}, {f"{name}_{of}[one]": -1e-5}) for name, of in SERIES},
    **{f"{NAME[name]}: d_k estimated": holds({f"{name}[less]": 1.2e-3}, {f"{name}[less]": 1e-5}) for name in NAME},
    "motor: the same where": holds({"late_less": 2.6e-4}, {"late_less": 1e-5}),
    "motor: a controller that filters": holds(
        {"off": 1.2, "ran": 3.73855, "apart": 0.1}, {"off": 4.1, "ran": 3.7432, "apart": 4.1}, **{"motor[estimate]": 3.73855}),
    "(7.33)": holds(
        {"over": -4e-7, "rise": -8e-4, "paid": 0.031, "gained": 0.071}, {"over": 1e-3, "rise": 2e-3, "paid": 0.0, "gained": 0.0}),
    "Remark 7.1": holds({"chain": 0.9011334}, {"chain": 0.9011335}, packets=0.9011334),
    "(7.41), Remark 7.6": holds(
        {"wide[verdict][ours]": "certified", "wide[margin][nominal]": 0.74, "wide[margin][ours]": 1.9},
        {"wide[verdict][ours]": OPEN, "wide[margin][nominal]": 1.01, "wide[margin][ours]": 0.99}),
    "(7.41): the guaranteed": holds(
        {"narrow[cost][ours]": 4.94, "narrow[ratio]": 1.56}, {"narrow[cost][ours]": 5.36, "narrow[ratio]": 1.0},
        **{"narrow[cost][nominal]": 5.35}),
    "Remark 7.7: a dynamic": holds(
        {"surely": 0.009, "mean[dynamic]": 0.0017, "verdict": "certified"},
        {"surely": -1e-3, "mean[dynamic]": 0.007, "verdict": OPEN}, half=0.0066),
    "8.2.1: gains": holds(
        {"share": 0.51, "radius": 0.69, "again": 2.28415, "ran": 1.16362},
        {"share": 1.01, "radius": 1.01, "again": 2.2842, "ran": 1.1637}, plain=2.28415, informed=1.16362),
    "8.2.1: runs": holds({"off": 0.65}, {"off": 4.1}),
}
# fmt: on
CHAPTERS = {"chapter2": CHAPTER_2, "chapter4": CHAPTER_4, "chapter7": CHAPTER_7}
TURNED = [(name, item, n) for name, table in CHAPTERS.items() for item, (*_, turns) in table.items() for n in range(len(turns))]


def stages_of(chapter: str) -> tuple[Stage, ...]:
    found: tuple[Stage, ...] = importlib.import_module(f"hil.thesis.{chapter}").CHAPTER.stages
    return found


def rows_of(stage: Stage, table: Table) -> Iterator[tuple[str, Statement]]:
    """The begin of each statement's item in the table, the longest that fits, and the statement without words."""
    for each in stage.statements:
        (*_, begin) = sorted((begin for begin in table if each.item.startswith(begin)), key=len)
        yield begin, replace(each, computed="", basis="", beside=())


def nested(numbers: Numbers) -> dict[Any, Any]:
    """Values that have these names, as ``parts[2][0].verdict``."""
    top: dict[Any, Any] = {}
    for name, value in numbers.items():
        ((_, field, *_),) = Formatter().parse(f"{{{name}}}")
        assert field is not None
        keys = field.replace("]", "").replace(".", "[.").split("[")
        at: Any = top
        for key, after in zip(keys, [*keys[1:], ""]):
            into = vars(at) if key.startswith(".") else at
            made = value if not after else SimpleNamespace() if after.startswith(".") else {}
            at = into.setdefault(int(key) if key.isdigit() else key.removeprefix("."), made)
    return top


def verdicts(rows: Mapping[str, Statement], numbers: Numbers) -> dict[str, str]:
    return {begin: row.verdict for begin, row in zip(rows, judge([*rows.values()], nested(numbers)), strict=True)}


@pytest.mark.parametrize(("chapter", "item", "n"), TURNED)
def test_a_wrong_number_turns_its_row(chapter: str, item: str, n: int) -> None:
    table = CHAPTERS[chapter]
    (rows,) = [rows for stage in stages_of(chapter) if item in (rows := dict(rows_of(stage, table)))]
    numbers = {name: value for begin in rows for name, value in table[begin][1].items()}
    stands = {begin: table[begin][0] for begin in rows}
    assert verdicts(rows, numbers) == stands
    change, then = table[item][2][n]
    assert change.keys() <= numbers.keys()
    found = verdicts(rows, numbers | change)
    assert found[item] == then
    assert {begin for begin in rows if found[begin] != stands[begin]} <= {b for b in rows if table[b][1].keys() & change.keys()}


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_every_number_that_decides_is_changed(chapter: str) -> None:
    table = CHAPTERS[chapter]
    rows = [row for stage in stages_of(chapter) for row in rows_of(stage, table)]
    assert len({begin for begin, _ in rows}) == len(rows) == len(table)
    for begin, row in rows:
        changed = {name for change, _ in table[begin][2] for name in change}
        assert {claim.name for claim in (*row.claims, *row.witness)} <= changed, begin
