"""Designs as JSON files, which an experiment names.

A file holds gains, norms, the certificate, and the problem that they solve. Whether its gains are for a loop is decided by
comparing that problem with the loop's, number by number.
"""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path
from typing import Any, Final

import numpy as np
from msgspec import Struct

from design.controllers import LoopModel
from design.errors import FieldError
from design.networked_loop.closed_loop import SELECTIONS
from design.processes.delay_chain import Array, DelayChain
from design.tracking import TrackingProblem, row_sojourns_of, state_gains_of, with_every_row
from design.tracking.synthesis import Design

MAX_BYTES: Final = 20_000_000
"""The most that a design file or a cache entry may have; the largest shipped one has 60 kB."""

LARGEST: Final = 1e100
"""The largest number that gains may hold: its square still is a number."""


def read_json(path: Path) -> Any:
    """Return what a JSON file holds.

    It has to be a regular file of bounded size; it is read without waiting.

    Args:
        path: the file.

    Raises:
        ValueError: it cannot be read, is no regular file, has more than `MAX_BYTES`, or is no JSON.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise ValueError("is no regular file")
            with open(descriptor, "rb", closefd=False) as file:
                data = file.read(MAX_BYTES + 1)
        finally:
            os.close(descriptor)
        if len(data) > MAX_BYTES:
            raise ValueError(f"has more than {MAX_BYTES} bytes")
        return json.loads(data.decode())
    except OSError as error:
        raise ValueError(error.strerror or str(error)) from None
    except RecursionError:
        raise ValueError("nested too deeply") from None


FORMAT = "hilrig-design/1"


class DesignFile(Struct, frozen=True, kw_only=True):
    """What a loop needs of a design file.

    Args:
        selection: row rule.
        gains: (tau labels, rows, m, py).
        state_gains: (tau labels, c, py) of the controller's own states, c = 0 without.
        integral: the last p columns belong to the integral of the measured error.
        samples: samples per sensor packet.
        sojourns: how many tables belong to every tau; () for one each.
        row_sojourns: how many rows belong to every d.
        period_s: sample period, s.
        plant: its name.
        document: everything that stands in the file.
    """

    selection: str
    gains: Array
    state_gains: Array
    integral: bool
    samples: int
    sojourns: tuple[int, ...]
    row_sojourns: int
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
        return _design(read_json(path))
    except ValueError as error:
        raise FieldError("design", f"{path}: {error}") from None


def _design(document: Any) -> DesignFile:
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise ValueError(f"no design file (format is not {FORMAT!r})")
    selection, problem = document.get("selection"), document.get("problem")
    if not isinstance(selection, str) or selection not in SELECTIONS:
        raise FieldError("selection", f"{selection!r:.60}, expected one of {', '.join(SELECTIONS)}")
    try:
        gains = np.array(document.get("gains"), dtype=np.float64)
    except (TypeError, ValueError):
        raise FieldError("gains", "expected a regular nested list [tau][row][m][p]") from None
    except OverflowError:
        raise FieldError("gains", "a number exceeds the range of a double") from None
    if gains.ndim != 4 or not (np.abs(gains) <= LARGEST).all():
        raise FieldError("gains", f"shape {gains.shape}, expected finite numbers of at most {LARGEST:g} [tau][row][m][p]")
    period = document.get("period_s")
    if not isinstance(period, int | float) or isinstance(period, bool) or not 0 < period < 1e9:
        raise FieldError("period_s", f"{period!r:.60}, expected a number > 0")
    known = problem if isinstance(problem, dict) else {}
    samples = known.get("samples", 1)
    if samples not in (1, 2):
        raise FieldError("problem.samples", f"{samples!r:.60}, expected 1 or 2")
    order, most = known.get("order", 0), min((gains.shape[1] - 1) * gains.shape[2], gains.shape[3] - 1)
    if not isinstance(order, int) or not 0 <= order <= max(most, 0):
        raise FieldError("problem.order", f"{order!r:.60}, expected a whole number of states that the gains have rows for")
    own, state_gains = state_gains_of(gains, order)
    stays, rows = _row_sojourns(known.get("ca"), own)
    return DesignFile(
        selection=selection,
        gains=rows,
        state_gains=state_gains,
        integral=bool(known.get("integral", 0)),
        samples=samples,
        sojourns=_sojourns(known.get("sc")),
        row_sojourns=stays,
        period_s=float(period),
        plant=str(document.get("plant", "")),
        document=document,
    )


def _chain(problem: Any, name: str) -> DelayChain:
    try:
        return DelayChain(**problem)
    except (TypeError, ValueError, OverflowError) as error:
        raise FieldError(f"problem.{name}", f"expected delays and labels: {error!s:.200}") from None


def _row_sojourns(problem: Any, gains: Array) -> tuple[int, Array]:
    """How many rows belong to every d, from the problem's chain, and gains with as many."""
    if problem is None:
        return 1, gains
    chain = _chain(problem, "ca")
    try:
        stays = row_sojourns_of(chain)
    except FieldError as error:
        raise FieldError("problem.ca", str(error)) from None
    if stays == 1:
        return stays, gains
    if gains.shape[1] != int(chain.label.max()) + 1:
        raise FieldError("gains", f"{gains.shape[1]} rows, expected one for each label of problem.ca")
    return stays, with_every_row(gains, chain, stays)


def _sojourns(problem: Any) -> tuple[int, ...]:
    """How many tables belong to every tau, from the problem's chain; () where that is one each."""
    if problem is None:
        return ()
    chain = _chain(problem, "sc")
    if chain.held is not None or np.array_equal(chain.label, chain.delay):
        return ()
    if chain.label.max() >= len(chain.label) or (np.diff(chain.label_delay, prepend=0) < 0).any():
        raise FieldError("problem.sc", "expected delays and labels, these 0, 1, ... in the order of the delays")
    return chain.sojourns


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
