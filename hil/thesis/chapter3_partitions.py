"""Sections 3.3 and 3.4 beyond the example.

What corners of a box of rates decide (Lemmas 3.1, 3.2), decay (Definition 3.1), sections (3.3.3), gains of (3.41) itself, and
what longer delays cost.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np

from design.as_printed import CHAPTER3_START, chapter3_gain, chapter3_process, chapter3_rate_bounds, chapter3_system
from design.as_printed.chapters_2_to_4 import delayed_section, free_gains, inequality_at
from design.processes.partitions import Partition
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.delayed_hinf import analyse_delayed, decay_of
from hil.pages import Figure, Series
from hil.thesis import Array, Plot, ReportProgress
from hil.thesis.noisy_runs import delayed_runs
from hil.thesis.statements import above, below, exactly, number_of, says, statement

BOUNDS = (5.0, 1.5)
"""Bounds on the norm of the gains, as for the sound levels."""

BOXES, INSIDE, SIZE = 200, 300, 4
WHOLE: Partition = ((0.0,),) * 3
SECTIONS: Partition = ((0.0, 1.8),) * 3
DURATION_S, RUNS = 10.0, 50


def _symmetric(entries: Array, diagonal: Array) -> Array:
    """Symmetric matrices (..., n, n) of the entries above the diagonal (..., n (n - 1) / 2) and the diagonal (..., n)."""
    n = diagonal.shape[-1]
    out = np.zeros((*entries.shape[:-1], n, n))
    above_diagonal = np.triu_indices(n, 1)
    out[..., above_diagonal[0], above_diagonal[1]] = entries
    out += np.swapaxes(out, -1, -2)
    out[..., np.arange(n), np.arange(n)] = diagonal
    return out


def _largest(matrices: Array) -> Array:
    return np.asarray(np.linalg.eigvalsh(matrices)[..., -1])


def interval_matrices(corners: str, seed: int = 0) -> float:
    """Return the largest eigenvalue inside boxes of symmetric matrices whose corners all have -0.01 or less.

    Args:
        corners: ``all`` of Lemma 3.1, or ``two``: all entries low and all entries high.
        seed: of the boxes and of the points inside.
    """
    rng, count = np.random.default_rng(seed), SIZE * (SIZE - 1) // 2
    chosen = np.array(list(itertools.product((0.0, 1.0), repeat=count)) if corners == "all" else [[0.0] * count, [1.0] * count])
    worst = -np.inf
    for _ in range(BOXES):
        low, diagonal = rng.uniform(-1, 1, count), rng.uniform(-1, 1, SIZE)
        high = low + rng.uniform(0, 2, count)
        diagonal = diagonal - _largest(_symmetric(low + (high - low) * chosen, diagonal)).max() - 0.01
        # Half of the points have some of their entries at an end.
        inside = rng.uniform(-0.5, 1.5, (INSIDE, count)).clip(0.0, 1.0)
        worst = max(worst, float(_largest(_symmetric(low + (high - low) * inside, diagonal)).max()))
    return worst


def rates_inside(certificate: JumpCertificate) -> tuple[float, float]:
    """Return the largest eigenvalues of (3.41), M = 1, at the corners of the VTOL's rates and inside."""
    system, process, rng = chapter3_system(), chapter3_process(), np.random.default_rng(0)
    low, high = (np.array(each) for each in zip(*(process.bounds(i, 0.0, np.inf) for i in range(3)), strict=True))
    at_corners = inside = -np.inf
    for i in range(3):
        others = np.arange(3) != i
        etas = low.sum(axis=1).max(), high.sum(axis=1).max()
        shares = np.array(list(itertools.product((0.0, 1.0), repeat=3)))
        for number, share in enumerate(np.vstack([shares, rng.random((INSIDE, 3))])):
            rates = np.zeros(3)
            rates[others] = (low[i] + (high[i] - low[i]) * np.insert(share[:2], i, 0.0))[others]
            eta = etas[0] + share[2] * (etas[1] - etas[0])
            found = float(_largest(inequality_at(system, certificate, i, rates.tolist(), eta)))
            if number < len(shares):
                at_corners = max(at_corners, found)
            else:
                inside = max(inside, found)
    return at_corners, inside


def partitions(report_progress: ReportProgress) -> dict[str, Any]:
    """Every number of this stage."""
    system, process, gain, high = chapter3_system(), chapter3_process(), chapter3_gain(), chapter3_rate_bounds()[1]
    report_progress("interval matrices", 0, 4)
    boxes = {corners: interval_matrices(corners) for corners in ("all", "two")}
    levels: dict[str, list[float]] = {"one": [], "two": []}
    for n, bound in enumerate(BOUNDS):
        report_progress(f"(3.41) with one section and with two, gain norm <= {bound:g}", 1 + n, 4)
        one = delayed_section(system, process, WHOLE, 0, None, reading="consistent", gain_bound=bound)
        both = [delayed_section(system, process, SECTIONS, m, None, reading="consistent", gain_bound=bound) for m in (0, 1)]
        levels["one"].append(one.gamma or np.nan)
        levels["two"].append(max(part.gamma or np.nan for part in both))
        if n == 0:
            at_corners, inside = rates_inside(one)
    report_progress("decay", 3, 4)
    decay = decay_of(system, process, analyse_delayed(system, gain, process))
    quiet = delayed_runs(system, gain, process, start=CHAPTER3_START, runs=RUNS, duration_s=DURATION_S, noise_s=1.0, noise=False)
    size = (quiet.x**2).sum(axis=2).mean(axis=0) / float(np.square(CHAPTER3_START).sum())
    return {
        "eta": float(high.sum(axis=2).max()), "largest": float(high.max()),
        "boxes": boxes, "corners": at_corners, "inside": inside, "levels": levels,
        "less": [one / two for one, two in zip(levels["one"], levels["two"], strict=True)],
        "rate": decay.rate, "sigma": decay.coefficient, "peak": float(size.max()),
        "over": float((size / (decay.coefficient * np.exp(-decay.rate * quiet.time_s))).max()),
    }  # fmt: skip


PARTITIONS = (
    statement(
        "(3.35): eta(h) <= max of the upper rates", "eta(h) <= max lambda_ij",
        below("largest eta(h) = -min lambda_ii(h) (1/s)", "eta", "largest"),
        witness=(above("largest eta(h) = -min lambda_ii(h) (1/s)", "eta", "largest"),),
        computed="eta(h) up to {eta:g}/s, the largest lambda_ij {largest:g}/s",
        basis="a row of (3.4) sums to 0, so that eta is a sum of rates; the conditions here have it so",
    ),
    statement(
        "Lemma 3.1: a symmetric matrix that is negative definite at all corners of its entries is so between them", "A < 0",
        below("largest eigenvalue inside", "boxes[all]", 0),
        basis=f"{BOXES} random boxes of {SIZE} x {SIZE} matrices, eigenvalues <= -0.01 at the corners, {INSIDE} points in each; "
        "with the corners 'all low' and 'all high' alone it would be {boxes[two]:+.2f}",
    ),
    statement(
        "Lemma 3.2: so it is with blocks that move together, lambda_ij(h) P_i of (3.41), for the VTOL", "A < 0",
        below("largest eigenvalue of (3.41) at the corners of rates and eta", "corners", 0),
        below("the same inside", "inside", 0),
        computed="{corners:.3g} at the corners, {inside:.3g} inside",
        basis=f"matrices found for M = 1, gain norm <= {BOUNDS[0]:g}; {INSIDE} points inside a mode's box",
    ),
    statement(
        "Definition 3.1: decay rate and decay coefficient sigma of the VTOL with the printed gains, no noise",
        "E|x|^2 <= sigma e^(-lambda t) |phi|^2",
        above("proved decay rate (1/s)", "rate", 0),
        above("sigma", "sigma", 1),
        below(f"largest E|x|^2 of {RUNS} runs over that bound", "over", 1),
        computed="lambda = {rate:.3g}/s, sigma = {sigma:.3g}; in runs E|x|^2 rises to {peak:.3g} |phi|^2 at most",
        basis="from P and Q of the corrected condition; neither number is printed",
    ),
    statement(
        "3.3.3: two partitions (Corollary 3.2) are less conservative than one (Corollary 3.1), by (3.41) as printed",
        "less conservative",
        *(
            above(f"smallest gamma of M = 1 over that of M = 2, gain norm <= {bound:g}", f"less[{n}]", 1.01)
            for n, bound in enumerate(BOUNDS)
        ),
        computed="{levels[one][0]:.4f} with M = 1, {levels[two][0]:.4f} with M = 2; {levels[one][1]:.4f}, {levels[two][1]:.4f}",
        readings=True,
        basis="one rate in both places, C'C and B'P in the wrong coordinates, sections not linked: part of this may be "
        "what is not sound; the corrected condition has a row of its own",
    ),
)  # fmt: skip

GAMMA = 0.93
DELAYS_S = (0.1, 0.2, 0.3, 0.6, 1.0, 1.5, 2.0)
SLOPES = (0.0, 0.3, 0.6, 0.9)


def further(report_progress: ReportProgress) -> dict[str, Any]:
    """Gains by (3.41) at the printed level, and certified levels of the printed gains over other delays."""
    system, process, printed = chapter3_system(), chapter3_process(), chapter3_gain()
    parts = [
        delayed_section(system, process, SECTIONS, m, None, reading="consistent", gain_bound=BOUNDS[0], gamma=GAMMA)
        for m in (0, 1)
    ]
    found = np.stack([free_gains(part, "012") for part in parts if part.certified], axis=1)
    levels: dict[str, list[float]] = {"delays": [], "slopes": []}
    for n, delay_s in enumerate(DELAYS_S):
        report_progress(f"delays up to {delay_s:g} s", n, len(DELAYS_S) + len(SLOPES))
        levels["delays"].append(number_of(analyse_delayed(replace(system, delay_max_s=delay_s), printed, process).gamma))
    for n, slope in enumerate(SLOPES):
        report_progress(f"slope {slope:g}", len(DELAYS_S) + n, len(DELAYS_S) + len(SLOPES))
        steady = replace(system, delay_slopes=np.full(system.modes, slope))
        levels["slopes"].append(number_of(analyse_delayed(steady, printed, process).gamma))
    curve = Series(label="printed gains", x=np.array(DELAYS_S), y=np.array(levels["delays"]))
    figure = Figure(title="certified gamma", series=(curve,), x_label="largest delay", x_unit="s", y_label="gamma", sync=None)
    return levels | {
        "parts": parts, "first": "; ".join(" ".join(f"{v:.4f}" for v in row) for row in found[0, 0]),
        "off": float(np.abs(found - printed.gain).max()) if found.shape == printed.gain.shape else math.nan,
        "size": float(np.abs(printed.gain).max()),
        "rise": {name: float(np.diff(each).min()) for name, each in levels.items()},
        "figures": (Plot(title="Longer delays", panels=(figure,), intro="Corrected condition, slopes h_i as printed."),),
    }  # fmt: skip


# fmt: off
FURTHER = (
    statement(
        "3.4: the gains of Corollary 3.2 at gamma = 0.93", "K(i, m), six matrices",
        *(says(f"(3.41), section {m + 1}, gains free", f"parts[{m}].verdict", "certified") for m in (0, 1)),
        exactly("largest difference of the gains", "off", 0, 0.5e-4, "size"),
        computed="K(1,1) = [{first}], largest difference {off:.3g}",
        basis=f"(3.41) with one rate in both places, gain norm <= {BOUNDS[0]:g}; half a unit of the last printed digit. An "
        "inequality alone, with no objective and no bound printed: the printed gains fulfil it too (above)",
    ),
    statement(
        "(3.2): longer delays and delays that grow faster cost attenuation, printed gains", "-",
        above(f"least rise of gamma, largest delays {DELAYS_S[0]:g} to {DELAYS_S[-1]:g} s", "rise[delays]", 0),
        above(f"least rise of gamma, slopes {SLOPES[0]:g} to {SLOPES[-1]:g}", "rise[slopes]", 0),
        computed="gamma {delays[0]:.3f} at 0.1 s, {delays[2]:.3f} at 0.3 s, {delays[6]:.3f} at 2 s; {slopes[0]:.3f} for delays "
        "that do not grow, {slopes[3]:.3f} for a slope of 0.9",
        basis="corrected condition; at other slopes the largest delay is 0.3 s",
    ),
)
# fmt: on
