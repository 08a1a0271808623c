"""A semi-Markov jump linear closed loop as Monte Carlo sees it, and its exact states at every event.

    dx = (A_i + dA_i + (B_i + dB_i) K(i', h)) x = M x,     M constant between events,

where an event is a jump of a process or the end of a section of the scheduled gain. One *segment* is the stretch
between two events; states at the events follow from x(t + s) = exp(M s) x(t) exactly.

The uncertainty is constant in time and drawn per run: norm-bounded with delta = diag(U[-1, 1]) (ERRATA 8),
or uniformly from the hull of the vertices.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.controllers.scheduled_gain import ScheduledGain
from design.errors import FieldError
from design.monte_carlo.jump_paths import MatrixFlow, Visits, fault_detection_visits, semi_markov_visits
from design.monte_carlo.parallel_runs import PARAMETERS, uniforms
from design.processes.elementary import log
from design.processes.semi_markov import FaultDetection, SemiMarkov
from design.semi_markov_loop.system import JumpSystem, NormBounded, VertexUncertainty

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
PARAMETER_PAGE = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JumpLoop:
    """System, gain and process of one closed loop, with its start.

    Args:
        system: N modes, n states.
        gain: scheduled by the mode and the clock that the controller sees (``hold``).
        process: jumps of the mode; a ``FaultDetection`` drives the plant by eta and the gain by r and its clock, or by
            eta * N_r + r and r's clock if ``gain.measured`` is ``("eta", "r")``.
        start: x(0), shape (n,).
        mode, detection: modes at 0; all clocks start at 0.
        uncertain: draw the system's uncertainty per run, constant in time; otherwise it is left out.
    """

    system: JumpSystem
    gain: ScheduledGain
    process: SemiMarkov | FaultDetection
    start: tuple[float, ...]
    mode: int = 0
    detection: int = 0
    uncertain: bool = False
    sees_failure: bool = field(init=False)

    def __post_init__(self) -> None:
        plant = self.process if isinstance(self.process, SemiMarkov) else self.process.failure
        seen = self.process.modes if isinstance(self.process, SemiMarkov) else self.process.detection[0].modes
        both = self.gain.measured == ("eta", "r")
        if both and isinstance(self.process, SemiMarkov):
            raise FieldError("gain", "measures eta and r, but the process is one semi-Markov process")
        object.__setattr__(self, "sees_failure", both)
        if plant.modes != self.system.modes:
            raise FieldError("process", f"{plant.modes} modes, the system has {self.system.modes}")
        if self.gain.modes != seen * (plant.modes if both else 1):
            raise FieldError("gain", f"{self.gain.modes} modes, the controller sees {seen * (plant.modes if both else 1)}")
        if self.gain.gain.shape[2:] != (self.system.inputs, self.system.states):
            raise FieldError(
                "gain", f"matrices of shape {self.gain.gain.shape[2:]}, expected {(self.system.inputs, self.system.states)}"
            )
        if self.gain.schedule != "hold":
            raise FieldError(
                "gain", "a gain that moves within a section has no exact flow; use design.monte_carlo.jump_loop.held first"
            )
        start = np.asarray(self.start, dtype=float)
        if start.shape != (self.system.states,) or not np.isfinite(start).all():
            raise FieldError("start", f"{self.start}, expected {self.system.states} finite numbers")
        if not 0 <= self.mode < plant.modes:
            raise FieldError("mode", f"{self.mode}, expected 0 to {plant.modes - 1}")
        if not 0 <= self.detection < seen:
            raise FieldError("detection", f"{self.detection}, expected 0 to {seen - 1}")
        uncertainty = self.system.uncertainty
        if self.uncertain and uncertainty is None:
            raise FieldError("uncertain", "the system has no uncertainty to draw from")
        if self.uncertain and isinstance(uncertainty, NormBounded) and uncertainty.e.shape[2] != uncertainty.fa.shape[1]:
            size = f"{uncertainty.e.shape[2]} x {uncertainty.fa.shape[1]}"
            raise FieldError("uncertain", f"delta = diag(...) must be square, it is {size}")

    def visits(self, duration_s: float, *, seed: int, first: int, runs: int) -> Iterator[Visits]:
        """Visits of the runs first, ..., first + runs - 1, each in its own stream."""
        if isinstance(self.process, SemiMarkov):
            return semi_markov_visits(self.process, self.mode, duration_s, seed=seed, first=first, runs=runs)
        return fault_detection_visits(
            self.process,
            self.mode,
            self.detection,
            duration_s,
            seed=seed,
            first=first,
            runs=runs,
            sees_failure=self.sees_failure,
        )

    def matrices(self, *, seed: int, first: int, runs: int) -> FloatArray:
        """M for every (mode, seen mode, section) and, if uncertain, every run: shape (n, n, W), see ``index``."""
        gain = self.gain.gain.reshape(-1, *self.gain.gain.shape[2:])
        a, b = self.system.a, self.system.b
        nominal = a[:, None] + _product(b[:, None], gain[None])  # (modes, gains, n, n)
        if not self.uncertain:
            return np.ascontiguousarray(np.moveaxis(nominal.reshape(-1, *a.shape[1:]), 0, -1))
        spread = self._directions(gain)  # (parameters, modes, gains, n, n)
        weights = self._weights(spread.shape[0], seed=seed, first=first, runs=runs)
        out = np.repeat(np.moveaxis(nominal, (2, 3), (0, 1))[..., None], runs, axis=-1)
        for direction, weight in zip(spread, weights, strict=True):
            out += np.moveaxis(direction, (2, 3), (0, 1))[..., None] * weight
        return out.reshape(*out.shape[:2], -1)

    def index(self, mode: IntArray, seen: IntArray, section: int, run: IntArray, runs: int) -> IntArray:
        """Where ``matrices`` holds the matrix of a visit's section."""
        modes, sections = self.gain.gain.shape[:2]
        which = (mode * modes + seen) * sections + section
        return np.asarray(which * runs + run if self.uncertain else which)

    def _directions(self, gain: FloatArray) -> FloatArray:
        uncertainty = self.system.uncertainty
        if isinstance(uncertainty, NormBounded):
            shape = uncertainty.fa[:, None] + _product(uncertainty.fb[:, None], gain[None])  # (modes, gains, q, n)
            return np.asarray(np.einsum("imq,igqn->qigmn", uncertainty.e, shape))
        assert isinstance(uncertainty, VertexUncertainty)
        return np.asarray(uncertainty.da[:, :, None] + _product(uncertainty.db[:, :, None], gain))

    def _weights(self, parameters: int, *, seed: int, first: int, runs: int) -> FloatArray:
        pages = -(-parameters // (4 * PARAMETER_PAGE))
        drawn = np.concatenate(
            [uniforms(seed, first, runs, blocks=PARAMETER_PAGE, purpose=PARAMETERS, page=page) for page in range(pages)]
        )[:parameters]
        if isinstance(self.system.uncertainty, NormBounded):
            return 2.0 * drawn - 1.0
        share = -log(drawn)  # normalised exponentials are uniform on the simplex
        return np.asarray(share / share.sum(axis=0))


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    """a @ b of stacks of small matrices, summed in one order on every machine."""
    out = a[..., :, 0, None] * b[..., None, 0, :]
    for k in range(1, a.shape[-1]):
        out = out + a[..., :, k, None] * b[..., None, k, :]
    return np.asarray(out)


class Segments(NamedTuple):
    """Stretches of constant matrix, those of one run in the order of time (not next to each other): shape (S,).

    ``which`` is the matrix; ``x`` (n, S) the state at ``first_s = grid * dt``, the first grid point in the segment;
    ``points`` is the number of grid points in it, which may be 0.
    """

    run: IntArray
    which: IntArray
    grid: IntArray
    points: IntArray
    x: FloatArray


def segments(
    loop: JumpLoop, flow: MatrixFlow, *, duration_s: float, dt_s: float, seed: int, first: int, runs: int
) -> tuple[Segments, FloatArray]:
    """All segments of a batch with the states at their first grid points, and the states at the end, shape (n, runs)."""
    last = round(duration_s / dt_s)
    state = np.repeat(np.asarray(loop.start, dtype=float)[:, None], runs, axis=1)
    parts: list[tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray]] = []
    for visits in loop.visits(duration_s, seed=seed, first=first, runs=runs):
        starts = loop.gain.starts_s[visits.seen]  # (S, sections)
        for section in range(starts.shape[1]):
            # This section's part of the visit, on the run's time axis; the clock read age_s at the visit's start.
            begin = visits.start_s + np.maximum(starts[:, section] - visits.age_s, 0.0)
            end = visits.stop_s
            if section + 1 < starts.shape[1]:
                end = np.minimum(end, visits.start_s + np.maximum(starts[:, section + 1] - visits.age_s, 0.0))
            here = np.flatnonzero(end > begin)
            if not here.size:
                continue
            run, begin, end = visits.run[here], begin[here], end[here]
            which = loop.index(visits.mode[here], visits.seen[here], section, run, runs)
            before = state[:, run]
            parts.append((run, which, begin, end, before))
            state[:, run] = flow.flow(which, before, end - begin)
    run, which, begin, end = (np.concatenate([part[k] for part in parts]) for k in range(4))
    x = np.concatenate([part[4] for part in parts], axis=1)
    grid = np.ceil(begin / dt_s).astype(np.intp)
    stop = np.where(end >= duration_s, last + 1, np.ceil(end / dt_s).astype(np.intp))
    points = np.maximum(stop - grid, 0)
    some = points > 0
    x[:, some] = flow.flow(which[some], x[:, some], np.maximum(grid[some] * dt_s - begin[some], 0.0))
    return Segments(run, which, grid, points, x), state
