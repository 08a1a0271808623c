"""Section 3.3: what corners of a box of rates decide (Lemmas 3.1, 3.2), decay (Definition 3.1), and sections (3.3.3)."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import numpy.typing as npt

from design.as_printed.delayed_hinf import inequality_at, printed_section
from design.as_printed.examples import CHAPTER3_START, chapter3_gain, chapter3_process, chapter3_system
from design.processes.partitions import Partition
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.decay_coefficient import decay_of
from design.semi_markov_loop.delayed_hinf import analyse_delayed
from hil.reproduce.chapter import ReportProgress
from hil.reproduce.noisy_runs import delayed_runs
from hil.reproduce.statements import Statement, above, below

Array = npt.NDArray[np.float64]
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
        inside = np.clip(rng.uniform(-0.5, 1.5, (INSIDE, count)), 0.0, 1.0)
        worst = max(worst, float(_largest(_symmetric(low + (high - low) * inside, diagonal)).max()))
    return worst


def rates_inside(certificate: JumpCertificate, seed: int = 0) -> tuple[float, float]:
    """Return the largest eigenvalues of (3.41), M = 1, at the corners of the VTOL's rates and inside."""
    system, process, rng = chapter3_system(), chapter3_process(), np.random.default_rng(seed)
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
    system, process, gain = chapter3_system(), chapter3_process(), chapter3_gain()
    report_progress("interval matrices", 0, 4)
    boxes = {corners: interval_matrices(corners) for corners in ("all", "two")}
    levels: dict[str, list[float]] = {"one": [], "two": []}
    for n, bound in enumerate(BOUNDS):
        report_progress(f"(3.41) with one section and with two, gain norm <= {bound:g}", 1 + n, 4)
        one = printed_section(system, process, WHOLE, 0, None, reading="consistent", gain_bound=bound)
        both = [printed_section(system, process, SECTIONS, m, None, reading="consistent", gain_bound=bound) for m in (0, 1)]
        levels["one"].append(one.gamma or np.nan)
        levels["two"].append(max(part.gamma or np.nan for part in both))
        if n == 0:
            at_corners, inside = rates_inside(one)
    report_progress("decay", 3, 4)
    decay = decay_of(system, process, analyse_delayed(system, gain, process))
    quiet = delayed_runs(system, gain, process, start=CHAPTER3_START, runs=RUNS, duration_s=DURATION_S, noise_s=1.0, noise=False)
    size = (quiet.x**2).sum(axis=2).mean(axis=0) / float(np.square(CHAPTER3_START).sum())
    return {
        "boxes": boxes, "corners": at_corners, "inside": inside, "levels": levels,
        "less": [one / two for one, two in zip(levels["one"], levels["two"], strict=True)],
        "rate": decay.rate, "sigma": decay.coefficient, "peak": float(size.max()),
        "over": float((size / (decay.coefficient * np.exp(-decay.rate * quiet.time_s))).max()),
    }  # fmt: skip


PARTITIONS = (
    Statement(
        "Lemma 3.1: a symmetric matrix that is negative definite at all corners of its entries is so between them",
        "A < 0",
        (below("largest eigenvalue inside", "boxes[all]", 0),),
        basis=f"{BOXES} random boxes of {SIZE} x {SIZE} matrices, eigenvalues <= -0.01 at the corners, {INSIDE} points in each; "
        "with the corners 'all low' and 'all high' alone it would be {boxes[two]:+.2f}",
    ),
    Statement(
        "Lemma 3.2: so it is with blocks that move together, lambda_ij(h) P_i of (3.41), for the VTOL",
        "A < 0",
        (
            below("largest eigenvalue of (3.41) at the corners of rates and eta", "corners", 0),
            below("the same inside", "inside", 0),
        ),
        computed="{corners:.3g} at the corners, {inside:.3g} inside",
        basis=f"matrices found for M = 1, gain norm <= {BOUNDS[0]:g}; {INSIDE} points inside a mode's box",
    ),
    Statement(
        "Definition 3.1: decay rate and decay coefficient sigma of the VTOL with the printed gains, no noise",
        "E|x|^2 <= sigma e^(-lambda t) |phi|^2",
        (
            above("proved decay rate (1/s)", "rate", 0),
            above("sigma", "sigma", 1),
            below(f"largest E|x|^2 of {RUNS} runs over that bound", "over", 1),
        ),
        computed="lambda = {rate:.3g}/s, sigma = {sigma:.3g}; in runs E|x|^2 rises to {peak:.3g} |phi|^2 at most",
        basis="from P and Q of the corrected condition; neither number is printed",
    ),
    Statement(
        "3.3.3: two partitions (Corollary 3.2) are less conservative than one (Corollary 3.1), by (3.41) as printed",
        "less conservative",
        tuple(
            above(f"smallest gamma of M = 1 over that of M = 2, gain norm <= {bound:g}", f"less[{n}]", 1.01)
            for n, bound in enumerate(BOUNDS)
        ),
        computed="{levels[one][0]:.4f} with M = 1, {levels[two][0]:.4f} with M = 2; {levels[one][1]:.4f}, {levels[two][1]:.4f}",
        readings=True,
        basis="one rate in both places, C'C and B'P in the wrong coordinates, sections not linked: part of this may be "
        "what is not sound; the corrected condition has a row of its own",
    ),
)
