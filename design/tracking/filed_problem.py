"""Whether the gains of a design file are for a loop: the problem that stands beside them, compared number by number."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from design.controllers import LoopModel
from design.errors import FieldError
from design.processes.delay_chain import DelayChain
from design.tracking.design_file import DesignFile
from design.tracking.gain_parametrisation import TrackingProblem

ROUNDING: Final = 1e-9
"""Share by which a number may differ: the stationary law of a chain is the same on every machine but for its last digits."""


def problem_of(read: DesignFile) -> TrackingProblem:
    """Return the problem that the gains of a design file solve.

    Raises:
        FieldError: the file does not state it.
    """
    said: Any = read.document.get("problem")
    try:
        chains = {name: DelayChain(**said[name]) for name in ("sc", "ca")}
        return TrackingProblem(**{**said, **chains})
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise FieldError("file", f"problem: {error!s:.200}; `hil design -o` writes it") from None


def differs(problem: TrackingProblem, model: LoopModel, sc: DelayChain, ca: DelayChain) -> str:
    """Return in which part the loop of a problem differs from another first, and by how much; empty: in none."""
    parts = [(f"{name} of the plant", np.asarray(getattr(problem, name)), getattr(model, name)) for name in "ABC"]
    for name, a, b in zip(("network.sc", "network.ca"), problem.chains, (sc, ca)):
        parts += [
            (f"the chain of {name}", a.matrix, b.matrix), (f"the ages of {name}", a.delay, b.delay),
            (f"the labels of {name}", a.label, b.label), (f"the held ages of {name}", a.holds, b.holds),
        ]  # fmt: skip
    for name, p, q in parts:
        if p.shape != q.shape:
            return f"{name}: shape {p.shape}, and not {q.shape}"
        gap = np.abs(p.astype(float) - q.astype(float))
        if gap.size and not gap.max() <= ROUNDING * max(1.0, float(np.abs(q).max())):
            return f"{name} differs by {float(gap.max()):.2g}"
    return ""
