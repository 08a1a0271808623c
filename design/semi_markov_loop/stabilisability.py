"""Requests that no gain can meet, found before any solver is asked.

If mode i has an eigenvalue mu that the input cannot reach (uncontrollable) and 2 Re mu is at least the largest total rate out
of the mode, then E|x|^2 has no finite value already within the first stay in that mode, whatever the gains.
"""

from __future__ import annotations

import numpy as np

from design.errors import Infeasible
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop.system import JumpSystem


def check_stabilisable(system: JumpSystem, process: SemiMarkov) -> None:
    """Raise Infeasible, with the mode, the eigenvalue and the rate, where the nominal system cannot be stabilised.

    The test (Popov-Belevitch-Hautus, relative tolerance 1e-9) finds certain cases only; passing it promises nothing.
    """
    for i in range(system.modes):
        a, b = system.a[i], system.b[i]
        size = max(float(np.linalg.norm(a, 2)), float(np.linalg.norm(b, 2)), 1e-300)
        exit_rate = float(process.bounds(i, 0.0, np.inf)[1].sum())
        for mu in np.linalg.eigvals(a):
            pencil = np.hstack([a - mu * np.eye(a.shape[0]), b.astype(complex)])
            if (
                2.0 * mu.real >= exit_rate
                and mu.real >= 0
                and np.linalg.svd(pencil, compute_uv=False)[-1] < 1e-9 * size
            ):
                raise Infeasible(
                    f"mode {i}: the eigenvalue {mu.real:+.4g} is out of the input's reach and grows faster than the mode is left "
                    f"(total rate at most {exit_rate:.4g}/s); no gains can stabilise the loop",
                    value=float(mu.real),
                )
