"""Designs as JSON files, which an experiment names: gains, norms, certificate, and the problem that they solve."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from design.errors import FieldError
from design.networked_loop.closed_loop import SELECTIONS
from design.processes.delay_chain import Array, DelayChain
from design.tracking.json_file import LARGEST, read_json
from design.tracking.synthesis import Design

FORMAT = "hilrig-design/1"


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignFile:
    """What a loop needs of a design file.

    Args:
        selection: row rule.
        gains: (tau labels, rows, m, py).
        integral: the last p columns belong to the integral of the measured error.
        samples: samples per sensor packet.
        sojourns: how many tables belong to every tau; () for one each.
        period_s: sample period, s.
        plant: its name.
        document: everything that stands in the file.
    """

    selection: str
    gains: Array
    integral: bool
    samples: int
    sojourns: tuple[int, ...]
    period_s: float
    plant: str
    document: dict[str, Any]


def to_document(design: Design, *, plant: str, period_s: float, wall_s: float, versions: dict[str, str]) -> dict[str, Any]:
    """The JSON form of a design.

    Args:
        plant: name of the plant.
        period_s: sample period, s.
        wall_s: time that solving took, s.
        versions: of packages.
    """
    problem, certificate = design.problem, design.certificate
    return {
        "format": FORMAT,
        "plant": plant,
        "period_s": period_s,
        "objective": problem.objective,
        "information": problem.information,
        "selection": design.selection,
        "gains": design.gains.tolist(),
        "norms": {"h2": certificate.h2_norm, "hinf": certificate.hinf_norm, "output": problem.output},
        "certificate": certificate.to_json(),
        "lower_bounds": None if design.bounds is None else design.bounds._asdict(),
        "gap": design.gap,
        "starts": [value if np.isfinite(value) else None for value in design.starts],
        "evaluations": design.evaluations,
        "problem": problem.to_json(),
        "seed": problem.seed,
        "wall_s": wall_s,
        "versions": versions,
    }


def design_text(document: dict[str, Any]) -> str:
    """The text of a design file."""
    return json.dumps(document, indent=1) + "\n"


def load_design(path: Path) -> DesignFile:
    """Read a design file.

    Raises:
        ValueError: cannot be read, is no design, or its gains do not fit its selection; the message starts with
            "design: " and the path.
    """
    try:
        document = read_json(path)
    except ValueError as error:
        raise FieldError("design", f"{path}: {error}") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise FieldError("design", f"{path}: no design file (format is not {FORMAT!r})")
    selection, problem = document.get("selection"), document.get("problem")
    if not isinstance(selection, str) or selection not in SELECTIONS:
        raise FieldError("design", f"{path}: selection: {selection!r:.60}, expected one of {', '.join(SELECTIONS)}")
    try:
        gains = np.array(document.get("gains"), dtype=np.float64)
    except (TypeError, ValueError):
        raise FieldError("design", f"{path}: gains: expected a regular nested list [tau][row][m][p]") from None
    except OverflowError:
        raise FieldError("design", f"{path}: gains: a number exceeds the range of a double") from None
    if gains.ndim != 4 or not (np.abs(gains) <= LARGEST).all():
        raise FieldError(
            "design", f"{path}: gains: shape {gains.shape}, expected finite numbers of at most {LARGEST:g} [tau][row][m][p]"
        )
    period = document.get("period_s")
    if not isinstance(period, int | float) or isinstance(period, bool) or not 0 < period < 1e9:
        raise FieldError("design", f"{path}: period_s: {period!r:.60}, expected a number > 0")
    known = problem if isinstance(problem, dict) else {}
    samples = known.get("samples", 1)
    if samples not in (1, 2):
        raise FieldError("design", f"{path}: problem.samples: {samples!r:.60}, expected 1 or 2")
    return DesignFile(
        selection=selection,
        gains=gains,
        integral=bool(known.get("integral", 0)),
        samples=samples,
        sojourns=_sojourns(path, known.get("sc")),
        period_s=float(period),
        plant=str(document.get("plant", "")),
        document=document,
    )


def _sojourns(path: Path, problem: Any) -> tuple[int, ...]:
    """How many tables belong to every tau, from the problem's chain; () where that is one each."""
    if problem is None:
        return ()
    try:
        chain = DelayChain(**problem)
    except (TypeError, ValueError, OverflowError) as error:
        raise FieldError("design", f"{path}: problem.sc: expected delays and labels: {error!s:.200}") from None
    if chain.held is not None or np.array_equal(chain.label, chain.delay):
        return ()
    if chain.label.max() >= len(chain.label) or (np.diff(chain.label_delay, prepend=0) < 0).any():
        raise FieldError("design", f"{path}: problem.sc: expected delays and labels, these 0, 1, ... in the order of the delays")
    return chain.sojourns
