"""Row by row: a number that decides is changed, and the verdict of its row turns, and no other one.

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
CHAPTER_3: Table = {
    **{f"gains of section {m + 1}": (FALSE, {f"literal[{m}].verdict": "refused"}, [
        ({f"literal[{m}].verdict": "certified"}, OK), ({f"literal[{m}].verdict": OPEN}, OPEN)]) for m in (0, 1)},
    **{f"section {m + 1} with": holds(
        {f"consistent[{m}].verdict": "certified", f"consistent[{m}].gamma": 0.929},
        {f"consistent[{m}].verdict": OPEN, f"consistent[{m}].gamma": 0.931}) for m in (0, 1)},
    "Theorem 3.1": (FALSE, {"accepted.verdict": "certified", "peak": 100.0}, [
        ({"accepted.verdict": "refused"}, NOT), ({"peak": 0.049}, OK)]),
    "Lemma 3.1": holds({"boxes[all]": -1e-9}, {"boxes[all]": 1e-9}),
    "Lemma 3.2": holds({"corners": -1e-9, "inside": -1e-9}, {"corners": 1e-9, "inside": 1e-9}),
    "Definition 3.1": holds({"rate": 1e-9, "sigma": 1.001, "over": 0.999}, {"rate": -1e-9, "sigma": 0.999, "over": 1.001}),
    **{f"3.3.3: two partitions (Corollary 3.2) are less conservative than one (Corollary 3.1), {how}": holds(
        {f"{name}[{n}]": 1.011 for n in (0, 1)}, {f"{name}[{n}]": 1.009 for n in (0, 1)}, OPEN)
       for how, name in (("by (3.41) as printed", "less"), ("corrected", "gain"))},
    "the unforced": holds({"unforced": 1e-3}, {"unforced": -1e-3}),
    "gamma = 0.93": holds({"published.verdict": "certified", "published.gamma": 0.929},
                          {"published.verdict": "refused", "published.gamma": 0.931}),
    "3.4: the gains": holds(
        {"parts[0].verdict": "certified", "parts[1].verdict": "certified", "off": 4e-5},
        {"parts[0].verdict": "refused", "parts[1].verdict": OPEN, "off": 6e-5}, size=1.7),
    "(3.2): longer": holds({"rise[delays]": 1e-9, "rise[slopes]": 1e-9}, {"rise[delays]": -1e-9, "rise[slopes]": -1e-9}),
    "||z|| / ||w||": holds(
        {f"ratios[{n}]": runs("0.2320") for n in range(4)}, {f"ratios[{n}]": runs("0.2320", 2.0) for n in range(4)}, OPEN,
        **{f"runs[{n}]": 401 for n in range(4)}),
    "the ratio is below": holds({"largest": 0.929}, {"largest": 0.931}),
    "vertical velocity": holds({"rms[0]": 0.99, "rms[1]": 0.99}, {"rms[0]": 1.01, "rms[1]": 1.01}, OPEN),
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
CHAPTER_5: Table = {
    "(5.2): the sensors": holds({"wrong": 0}, {"wrong": 1}),
    "(5.1), (5.4)": holds({"loop": 9e-6}, {"loop": 1.1e-5}),
    "(5.3): a run": holds({"spent": 220.2}, {"spent": 220.2002}, exact=220.2),
    "m = tau": holds({"oldest": 5, "m": 3}, {"oldest": 4, "m": 4}, buffer=3),
    "(5.8): the zero": holds({"differ": 0, "free": 15}, {"differ": 1, "free": 14}),
    "Remark 5.1": holds({"known": 3, "late": 0}, {"known": 2, "late": 1}),
    "the controller has 24": (FALSE, {"matrices": 24, "shape[0]": 1, "shape[1]": 4}, [
        ({"shape[0]": 4}, OK), ({"shape[0]": 2}, NOT), ({"shape[1]": 1}, NOT), ({"shape[0]": 4, "matrices": 23}, NOT)]),
    "Remark 5.3": (FALSE, {"paths": 1, "strange": 0}, [({"paths": 2}, OK), ({"strange": 1}, NOT)]),
    "5.4: n = 4": holds(
        {"n": 4, "p": 1, "tau": 5, "xi": 0.0, "x0": 0.0}, {"n": 5, "p": 2, "tau": 4, "xi": 1e-3, "x0": 1.0}, weight=0.1),
    "Figures 5.3, 5.4: both": holds({"newest": "certified"}, {"newest": OPEN}, OPEN),
    "5.5: a stochastic": holds({"random_radius": 0.99}, {"random_radius": 1.01}),
    "(5.16): zero": holds({"stray": 0.0, "used": 60}, {"stray": 1e-4, "used": 59}),
    "J of (5.16)": holds({"J[1]": 220.249, "alike": 1}, {"J[1]": 220.251, "alike": 2}),
    "the proposed controller stabilises": holds({"certificate": "certified"}, {"certificate": "refused"}),
    "5.5: the proposed": (FALSE, {"less": 0.1, "least": 0.1, "gain": 0.049}, [
        ({"less": -0.1}, OK), ({"least": -0.1}, NOT), ({"gain": 0.051}, NOT)]),
    "Theorem 5.1: a bound": (FALSE, {"schur": 1, "radius": 1.01}, [({"schur": 4}, OK), ({"radius": 0.99}, NOT)]),
    "(5.15)": (FALSE, {"printed": -1.0, "right": 1.0}, [({"printed": 1.0}, OK), ({"right": -1.0}, NOT)]),
    "historical data": holds({"mean[0]": 1.81}, {"mean[0]": 1.83}, **{"mean[1]": 1.82}),
    "Remark 5.2": (FALSE, {"missing": 8, "shifted": 0}, [({"missing": 0}, OK), ({"shifted": 1}, NOT)]),
    **{f"(5.18): an input weight, with the largest input of {gains}": holds(
        {f"more[{n}]": 9e-10, f"share[{n}]": 0.99}, {f"more[{n}]": 2e-9, f"share[{n}]": 1.01})
       for n, gains in enumerate(("(5.16)", "(5.17)"))},
    "(5.2): the order": holds({"order": 1.004}, {"order": 1.006}),
    "(5.16) feels": holds({"noise[0]": 1.0}, {"noise[0]": 2.0}, **{"noise[1]": 1.5}),
    "Theorem 5.1: one P": holds({"bound": 250.1}, {"bound": 249.9}, worst=250.0),
    "Theorem 5.1 on": holds({"tangent[saved]": 1e-9, "tangent[eigenvalue]": -1e-9, "tangent[worst]": 0.99},
                            {"tangent[saved]": -1e-9, "tangent[eigenvalue]": 1e-9, "tangent[worst]": 1.01}),
    "Theorem 5.1 by": holds({"cone[bound]": 14.79, "cone[eigenvalue]": -1e-9}, {"cone[bound]": 14.81, "cone[eigenvalue]": 1e-9}),
    "Figures 5.3, 5.4: the proposed controller is": holds({"rough": 0.99}, {"rough": 1.01}),
    "Figures 5.3, 5.4: smoother": holds({"x2_x4": 0.4}, {"x2_x4": 0.6}, x1_x3=0.5),
    "Figures 5.3, 5.4: the proposed controller settles": holds({"later": 1.0}, {"later": 0.0}),
}
CHAPTER_6: Table = {
    "(6.2)": holds(
        {"fit.inertia.value": 0.7943, "fit.damping.value": 1.9857, "fit.residuals.verdict": "white"},
        {"fit.inertia.value": 0.7985, "fit.damping.value": 1.9816, "fit.residuals.verdict": "correlated"},
        **{"fit.inertia.error": 1e-3, "fit.damping.error": 1e-3}),
    "(6.1)": holds({"far": 1.0, "angle": 10.1}, {"far": 0.99, "angle": 9.9}),
    "6.2.2: lambda_ii": holds({"rows": 0.0, "entry": 0.15}, {"rows": 1e-3, "entry": 0.0}),
    "Remark 6.2": holds({"touch": 0.0, "radius": 0.99}, {"touch": 1e-3, "radius": 1.01}),
    "(6.4) to (6.6)": holds({"rig": 0.9, "delay": 0.15}, {"rig": 1.1, "delay": 0.1}, largest=50.0),
    "(6.8)": holds({"force": 0.0}, {"force": 1e-8}),
    "Figures 6.5": holds({"split": 0.0}, {"split": 1e-11}),
    "(6.17)": (FALSE, {"share": 7e-5, "certifies": "certifies", "norm": 601.0}, [
        ({"share": 1.1}, OK), ({"certifies": "does not certify"}, NOT), ({"norm": 599.0}, NOT)]),
    "6.5.2: it is clear": (FALSE, {"felt": 0.009}, [({"felt": 0.011}, OK)]),
    "Remark 6.1": holds({"repeated": 0.0}, {"repeated": 1e-11}),
    "6.2.2: with": holds({"least": 0.5, "most": 0.5}, {"least": 0.49, "most": 0.51}),
    "6.3: constant": holds({"ages": 0.0}, {"ages": 1e-9}),
    "6.3: a coupler": holds({"needed": 1.984, "bare": 2.0}, {"needed": 1.99, "bare": 1.98}, b=1.9857, least_b=1.9658),
    "(6.7)": (FALSE, {"nearer": 0.99, "farther": 1.01}, [({"nearer": 1.01}, OK), ({"farther": 0.99}, NOT)]),
    "6.4: a coupler of": (FALSE, {"meets": "misses (6.9)"}, [({"meets": "meets (6.9)"}, OK)]),
    "(6.15), (6.16)": holds({"share": 0.99, "ratio": 1.01}, {"share": 1.01, "ratio": 0.99}),
    "6.6: the coupler": holds({"needed": 1.984}, {"needed": 1.96}, b=1.9857, least_b=1.9658),
    "6.5: Lambda": holds({"error": 0.0}, {"error": 1e-11}, entry=0.7),
    "(6.3)": (FALSE, {"apart": 2.0}, [({"apart": 1.0}, OK)]),
    "6.5.2: material 3": holds({"balance": 0.0, "areas": 1.01}, {"balance": 1e-11, "areas": 0.99}),
    "6.2.2: one step": holds({"off": 0.019}, {"off": 0.021}),
    "6.1: the movement": (FALSE, {"G": 101.0, "limit": 10.0, "far": 100.0, "freedom": 4}, [({"G": 99.0}, NOT), ({"G": 9.9}, OK)]),
    "Figure 6.10": holds({"slide": "found"}, {"slide": "not found"}),
    "6.3: without": holds({"bare": 2.0, "B": 2.0}, {"bare": 1.9, "B": 1.9}, b=1.9857),
    "Theorem 6.1": (FALSE, {"radius[2]": 1.1, "meets": "meets (6.9)", "radius[0]": 0.99, "radius[1]": 1.01}, [
        ({"radius[2]": 0.99}, OK), ({"meets": "misses (6.9)"}, NOT), ({"radius[0]": 1.01}, NOT), ({"radius[1]": 0.99}, NOT)]),
    "Remark 6.3": (FALSE, {"moments": 1.01}, [({"moments": 0.99}, OK)]),
    "(6.10)": (FALSE, {"real[0]": 0.1, "real[1]": -0.1}, [({"real[1]": 0.1}, OK), ({"real[0]": -0.1}, NOT)]),
    "(6.11)": (FALSE, {"press[0]": -0.9, "press[1]": 0.0}, [({"press[0]": 0.0}, OK), ({"press[1]": -1e-3}, NOT)]),
    "(6.14)": (FALSE, {"printed": 0.0, "meant": 101.0}, [({"printed": 101.0}, OK), ({"meant": 99.0}, NOT)]),
    "(6.12)": (FALSE, {"best": 1001.0, "without": 1001.0, "bound": 999.0, "off": 1000.0}, [
        ({"best": 999.0}, OK), ({"without": 999.0}, NOT), ({"bound": 1001.0}, NOT)]),
    "6.4: C =": (FALSE, {"drift": 1.1}, [({"drift": 0.9}, NOT), ({"drift": 0.009}, OK)]),
    "6.4: couplers": (FALSE, {"jump": -0.011, "each": "meet (6.9)", "handed": 0.0}, [
        ({"jump": -0.009}, NOT), ({"jump": 0.0}, OK), ({"each": "miss (6.9)"}, NOT), ({"handed": -1e-3}, NOT)]),
    "6.4: a coupler for": holds({"own": "certified", "stiffer": 1.01, "clearer": 0.99, "of_ceiling": 0.999},
                                {"own": "refused", "stiffer": 0.99, "clearer": 1.01, "of_ceiling": 0.997}),
    "6.4: a weighting": holds({"weighed": 0.99, "softer": 1.01}, {"weighed": 1.01, "softer": 0.99}),
    "(6.15): the": (FALSE, {"levels": 0.0, "norms": 1.021}, [({"levels": 1e-8}, OK), ({"norms": 1.019}, NOT)]),
    "6.6: damping": holds({"zones": "certified", "for_b": OPEN}, {"zones": "refused", "for_b": "certified"}),
    "6.6: a random": holds({"moving": "certified", "each_held": OPEN, "waiting": 1.01},
                           {"moving": "refused", "each_held": "certified", "waiting": 0.99}),
    "6.6: a sliding": holds({"paced": 0.99, "paces": "certified"}, {"paced": 1.01, "paces": "refused"}),
    "Figure 6.8: materials": holds({"apart": 9e-4, "deeper": 0.2509}, {"apart": 1.1e-3, "deeper": 0.2511}, final=30.0),
    "Figure 6.8: decaying": holds({"overshoot": 1.01, "rest": 0.099}, {"overshoot": 0.99, "rest": 0.101}),
    "Figure 6.8: the delays": (FALSE, {"start": 0.11}, [({"start": 0.0}, OK), ({"start": 0.09}, NOT)]),
    "Figure 6.9": holds({"share": 9e-4, "deepest": 4.9}, {"share": 1.1e-3, "deepest": 5.1}),
    "6.5.2: simulated": holds({"order": 9.9}, {"order": 10.1}),
    "6.5.2: the trajectory": holds({"arc": 0.049}, {"arc": 0.051}),
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
CHAPTERS = {
    "chapter2": CHAPTER_2, "chapter3": CHAPTER_3, "chapter4": CHAPTER_4, "chapter5": CHAPTER_5, "chapter6": CHAPTER_6,
    "chapter7": CHAPTER_7,
}  # fmt: skip


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


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_a_wrong_number_turns_its_row(chapter: str) -> None:
    table = CHAPTERS[chapter]
    for stage in stages_of(chapter):
        rows = dict(rows_of(stage, table))
        numbers = {name: value for begin in rows for name, value in table[begin][1].items()}
        stands = {begin: table[begin][0] for begin in rows}
        assert verdicts(rows, numbers) == stands
        for item, (change, then) in ((begin, turn) for begin in rows for turn in table[begin][2]):
            assert change.keys() <= numbers.keys()
            found = verdicts(rows, numbers | change)
            turned = {begin for begin in rows if found[begin] != stands[begin]}
            assert found[item] == then and turned <= {b for b in rows if table[b][1].keys() & change.keys()}, (item, change)


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_every_number_that_decides_is_changed(chapter: str) -> None:
    table = CHAPTERS[chapter]
    rows = [row for stage in stages_of(chapter) for row in rows_of(stage, table)]
    assert len({begin for begin, _ in rows}) == len(rows) == len(table)
    for begin, row in rows:
        changed = {name for change, _ in table[begin][2] for name in change}
        assert {claim.name for claim in (*row.claims, *row.witness)} <= changed, begin
