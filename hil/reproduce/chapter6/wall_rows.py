"""Section 6.2.2: the mixed wall, its transition matrix, and the assumption that sliding has no memory."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.stats import chi2

from design.as_printed.chapter6 import LAMBDA
from design.controllers.wall_pattern import square_rows
from design.passivity.material_chain import boundaries, material_chain, memory_statistic, true_chain
from hil.reproduce.statements import Statement, above, below, exactly, says

SIDE_M = 0.02
STEP_M = 0.15 * math.pi * SIDE_M
MODES_610 = (1, 2, 1, 2, 1, 0)  # {2, 3, 2, 3, 2, 1}
LEVEL = 1e-3


def wall() -> dict[str, Any]:
    """Return the numbers of Section 6.2.2 and of Figure 6.10."""
    pattern, printed = square_rows(SIDE_M), np.array(LAMBDA)
    lengths, areas = boundaries(pattern, 3)
    leaving = 1.0 - np.diag(printed)
    statistic, freedom = memory_statistic(slide(0.35, 20_000), 3)
    limit = float(chi2.isf(LEVEL, freedom))
    heading = next((a for a in np.linspace(0.05, 1.5, 300).tolist() if visits(a) == MODES_610), math.nan)
    stationary = areas / areas.sum()
    return {
        "error": float(np.abs(material_chain(pattern, 3, STEP_M) - printed).max()), "entry": float(printed.max()),
        "apart": float(leaving.max() / leaving.min()), "balance": float(np.abs(stationary @ printed - stationary).max()),
        "areas": float(areas[2] / areas[0]), "length": lengths[0, 1], "freedom": freedom, "G": statistic, "limit": limit,
        "far": 10.0 * limit, "heading": math.degrees(heading),
        "slide": "not found" if math.isnan(heading) else "found",
        "off": float(np.abs(true_chain(pattern, 3, STEP_M) - printed).max()),
    }  # fmt: skip


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


# fmt: off
WALL = (
    Statement(
        "6.5: Lambda from a pattern of patches", "0.4 0.3 0.3; 0.3 0.4 0.3; 0.15 0.15 0.7",
        (exactly("largest difference", "error", 0, 1e-12, "entry"),),
        basis="lambda_ij = nu T c_ij/(pi A_i) over rows of squares between strips, nu T = 0.15 pi w",
    ),
    Statement(
        "(6.3): lambda_ij in proportion to c_ij/sum c_ij and nu", "one factor for every i",
        (exactly("ratio of the probabilities with which Lambda leaves its materials", "apart", 1, 1e-9),),
        (above("that ratio", "apart", 1.0 + 1e-9),),
        basis="the printed rows of (6.3) sum to nu times one factor; the areas are missing from it",
    ),
    Statement(
        "6.5.2: material 3 is left less often, as its area is larger", "0.15 < 0.3",
        (
            exactly("distance of the area shares from the stationary law of Lambda", "balance", 0, 1e-12),
            above("area of material 3 over that of material 1", "areas", 1),
        ),
        basis="the same pattern; boundaries of {length:g} m each",
    ),
    Statement(
        "6.2.2: one step of the avatar follows Lambda", "Lambda",
        (below("distance of the exact one-step matrix of the geometry", "off", 0.02),),
        basis="uniform place and direction, nu T = 0.15 pi w; the linear law holds for short steps only",
    ),
    Statement(
        "6.1: the movement is independent of the past, so the material is a Markov process", "memoryless",
        (below(f"G on {{freedom}} degrees of freedom, level {LEVEL:g}:", "G", "limit"),), (above("G", "G", "far"),),
        basis="20,000 samples of a straight slide at the published speed",
    ),
    Statement(
        "Figure 6.10: the modes {2, 3, 2, 3, 2, 1}", "2 3 2 3 2 1",
        (says("a straight slide that shows them", "slide", "found"),),
        computed="heading {heading:.2f} degrees", basis="the same pattern, from within material 2, of 300 headings",
    ),
)
# fmt: on
