"""Section 6.2.2: the mixed wall, its transition matrix, and the assumption that sliding has no memory."""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import chi2

from design.as_printed.coupler import LAMBDA
from design.controllers.wall_pattern import square_rows
from design.passivity.material_chain import boundaries, material_chain, memory_statistic, true_chain
from hil.reproduce.judgement import Row, above, below, row, within

SIDE_M = 0.02
STEP_M = 0.15 * math.pi * SIDE_M
MODES_610 = (1, 2, 1, 2, 1, 0)  # {2, 3, 2, 3, 2, 1}
LEVEL = 1e-3


def wall_rows() -> list[Row]:
    """Return the rows of Section 6.2.2 and of Figure 6.10."""
    pattern, printed = square_rows(SIDE_M), np.array(LAMBDA)
    error = float(np.abs(material_chain(pattern, 3, STEP_M) - printed).max())
    lengths, areas = boundaries(pattern, 3)
    leaving = 1.0 - np.diag(printed)
    apart = float(leaving.max() / leaving.min())
    truth = true_chain(pattern, 3, STEP_M)
    off = float(np.abs(truth - printed).max())
    statistic, freedom = memory_statistic(slide(0.35, 20_000), 3)
    limit = float(chi2.isf(LEVEL, freedom))
    heading = next((a for a in np.linspace(0.05, 1.5, 300).tolist() if visits(a) == MODES_610), math.nan)
    stationary = areas / areas.sum()
    balance = float(np.abs(stationary @ printed - stationary).max())
    return [
        row(
            "6.5: Lambda from a pattern of patches", "0.4 0.3 0.3; 0.3 0.4 0.3; 0.15 0.15 0.7",
            below("largest difference", error, 1e-12),
            basis="lambda_ij = nu T c_ij/(pi A_i) over rows of squares between strips, nu T = 0.15 pi w",
        ),
        row(
            "(6.3): lambda_ij in proportion to c_ij/sum c_ij and nu", "one factor for every i",
            below("ratio of the probabilities with which Lambda leaves its materials", apart, 1.0 + 1e-9),
            witness=(above("that ratio", apart, 1.0 + 1e-9),),
            basis="the printed rows of (6.3) sum to nu times one factor; the areas are missing from it",
        ),
        row(
            "6.5.2: material 3 is left less often, as its area is larger", "0.15 < 0.3",
            below("distance of the area shares from the stationary law of Lambda", balance, 1e-12),
            above("area of material 3 over that of material 1", float(areas[2] / areas[0]), 1.0),
            basis=f"the same pattern; boundaries of {lengths[0, 1]:g} m each",
        ),
        row(
            "6.2.2: one step of the avatar follows Lambda", "Lambda",
            below("distance of the exact one-step matrix of the geometry", off, 0.02),
            basis="uniform place and direction, nu T = 0.15 pi w; the linear law holds for short steps only",
        ),
        row(
            "6.1: the movement is independent of the past, so the material is a Markov process", "memoryless",
            below(f"G on {freedom} degrees of freedom, level {LEVEL:g}:", statistic, limit),
            witness=(above("G", statistic, 10.0 * limit),),
            basis="20,000 samples of a straight slide at the published speed",
        ),
        row(
            "Figure 6.10: the modes {2, 3, 2, 3, 2, 1}", "2 3 2 3 2 1",
            within("heading of a straight slide that shows them, degrees", math.degrees(heading), 0.0, 90.0),
            basis="the same pattern, from within material 2",
        ),
    ]  # fmt: skip


def slide(heading: float, samples: int, step_m: float = STEP_M) -> list[int]:
    """Return the materials that a straight slide meets, one per sample."""
    pattern = square_rows(SIDE_M)
    y, z = math.cos(heading) * step_m, math.sin(heading) * step_m
    return [pattern.material_at(1.5 * SIDE_M + k * y, 0.1 * SIDE_M + k * z) for k in range(samples)]


def visits(heading: float) -> tuple[int, ...]:
    """Return the first six different materials of a straight slide, in fine steps."""
    path = slide(heading, 2000, 0.02 * SIDE_M)
    changes = [m for i, m in enumerate(path) if i == 0 or path[i - 1] != m]
    return tuple(changes[:6])
