"""Controllers that an experiment asks for by what they shall achieve: solved, or read, when the experiment is composed.

What runs is the table of gains that came out (:class:`design.controllers.SendAll`); no process that keeps time solves anything.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from design.controllers import LoopModel, SendAll, nested


@dataclass(frozen=True, slots=True, kw_only=True)
class Designed:
    """A tracking design of Chapter 7, for the loop that it will run in.

    Parameters
    ----------
    objective : str
        ``h2`` (7.26), ``hinf`` (7.31) or ``mixed`` (7.33).
    information : str
        What the gain may depend on: ``constant``, ``tau``, ``previous``, ``generated`` (printed), ``applied``, ``both``,
        ``total``.
    hinf_bound : float, optional
        Mixed only: bound of the H-infinity norm.
    gain_bound : float, optional
        Bound on every entry of every gain.
    input_weight : float
        R of z = [Q x; R u1], Q = C.
    output : str
        ``stacked`` or ``sum`` (as printed).
    integral : float
        Weight of the integrated error; above 0 the controller integrates (Remark 7.7).
    design_seed : int
        Seed of the multistart.
    file : str
        A design saved by ``hil design -o``; then nothing is solved. Relative to the experiment's file.
    """

    objective: Literal["h2", "hinf", "mixed"] = "h2"
    information: Literal["constant", "tau", "previous", "generated", "applied", "both", "total"] = "applied"
    hinf_bound: float | None = None
    gain_bound: float | None = None
    input_weight: float = 0.01
    output: Literal["stacked", "sum"] = "stacked"
    integral: float = 0.0
    design_seed: int = 0
    file: str = ""

    def solve(self, model: LoopModel, sc: Any, ca: Any, folder: str) -> SendAll:
        """Return the gains for a loop.

        Parameters
        ----------
        model : LoopModel
            The plant and the largest delays.
        sc, ca : DelayChain or None
            The chains of both directions; None where a law has none.
        folder : str
            Where relative file names begin.

        Raises
        ------
        ValueError
            The message starts with the field.
        """
        if self.file:
            return _read(Path(folder) / self.file, self.file)
        if sc is None or ca is None:
            raise ValueError("kind: a design needs age laws with a chain on both links, not packet laws or traces")
        from design.cache import solve_cached
        from design.tracking import TrackingProblem

        problem = TrackingProblem(
            A=model.A, B=model.B, C=model.C, sc=sc, ca=ca, objective=self.objective, information=self.information,
            R=self.input_weight, output=self.output, hinf_bound=self.hinf_bound, gain_bound=self.gain_bound,
            integral=self.integral, seed=self.design_seed,
        )  # fmt: skip
        design = solve_cached(problem)
        return SendAll(
            gains=nested(np.asarray(design.gains)),
            selection=design.selection,  # type: ignore[arg-type]
            integral=self.integral > 0,
        )


def _read(path: Path, name: str) -> SendAll:
    try:
        data = json.loads(path.read_text())
    except OSError as e:
        raise ValueError(f"file: {name}: cannot be read: {e.strerror}") from e
    except ValueError as e:
        raise ValueError(f"file: {name}: not JSON: {e}") from e
    try:
        gains, selection = np.asarray(data["gains"], dtype=float), str(data["selection"])
        if gains.ndim != 4 or not np.isfinite(gains).all():
            raise ValueError
    except (KeyError, TypeError, ValueError):
        raise ValueError(f"file: {name}: not a design: it needs selection and gains [tau][row][m][p]") from None
    return SendAll(gains=nested(gains), selection=selection, integral=bool(data.get("integral", False)))  # type: ignore[arg-type]
