"""Mean and spread of the tracking error of any experiment, exactly, transients included.

In coordinates of deviation from the ideal response (7.8) the loop is X(k+1) = A_i X(k) + B w(k), its reference steps
are jumps of X, and everything random is the mode. With xi = [X; 1] and eta = the coordinates of xi xi',

    eta(k+1) = W_i eta(k),      s(k+1) = s(k) + T |e(k)|^2      (linear in eta)

is a jump-linear system again, so one recursion of the second moments of [eta; s] gives, at every slot, the mean of the error
(through the 1), its variance, mean and variance of its square, and mean and variance of the sums of Table 7.2. Those of eta are
fourth moments of xi: each is computed once, as a monomial, and not for every order of its factors.

Before slot 0 the plant was at rest in its first state: the samples that the first packet carries beside the newest are
y(0). Before the first sample has come the controller answers zeros, and before the first packet the input is 0. An actuator
that has no packet measures no delay, and a row that is chosen by this delay is that of the longest one. The rows of packets
under way when the reference steps were computed for the old one. What else acts on the state and is known (a load) is a drive
f(k). All of this is in the recursion.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from design.controllers import Selection
from design.controllers.gain_rows import held_exactly, steady_state
from design.errors import DesignError, FieldError
from design.networked_loop import check_gains
from design.networked_loop.affine_loop import LoopStructure
from design.networked_loop.closed_loop import loop_structure
from design.networked_loop.moment_recursion import MomentRecursion
from design.processes.delay_chain import Array, DelayChain, as_chain


class Prediction(Struct, frozen=True, kw_only=True):
    """Exact moments of the tracking error e = y - target at slots k = 0..K-1 over the randomness of the network.

    Args:
        error_mean, error_sd: (K, p) in output units.
        square_mean, square_sd: (K,) of |e(k)|^2, e over the tracked outputs.
        sum_mean, sum_sd: (sums,) of T sum |e(k)|^2 from each start slot on, output units squared times s.
    """

    error_mean: Array
    error_sd: Array
    square_mean: Array
    square_sd: Array
    sum_mean: Array
    sum_sd: Array


def predict_tracking(
    A: npt.ArrayLike,
    B: npt.ArrayLike,
    C: npt.ArrayLike,
    Lambda: DelayChain | npt.ArrayLike,
    Pi: DelayChain | npt.ArrayLike,
    gains: npt.ArrayLike,
    selection: Selection | str,
    reference: npt.ArrayLike,
    *,
    period_s: float,
    target: npt.ArrayLike | None = None,
    disturbance: npt.ArrayLike | None = None,
    initial: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    x0: npt.ArrayLike | None = None,
    drive: npt.ArrayLike | None = None,
    tracked: Sequence[int] | None = None,
    samples: int = 1,
    integral: bool = False,
    state_gains: npt.ArrayLike = (),
    sums_from: tuple[int, ...] = (0,),
) -> Prediction:
    """Predict the tracking error of an experiment.

    Args:
        A, B, C: (n, n), (n, m), (p, n) discrete plant.
        Lambda, Pi: S-C and C-A transition matrices or delay chains.
        gains, selection: the loop's gains and row rule.
        reference: (K,) or (K, p), r(k).
        period_s: sample period T, s.
        target: (K,) or (K, p), what y is compared with; default the reference. Tables 7.1 and 7.2 count the error to the
            step's value from t = 0 on.
        disturbance: (K,) or (K, m) input disturbance w(k); default none.
        initial: distributions of the S-C and C-A mode at k = 0; default stationary.
        x0: (n,) plant state at k = 0 and before; default 0.
        drive: (K, n), f(k) in x(k+1) = A x(k) + B (u(k) + w(k)) + f(k), states' units; default none.
        tracked: outputs whose squares are summed, of one unit; default all.
        samples, integral, state_gains: as the gains were designed, see `design.networked_loop.closed_loop.loop_structure`.
        sums_from: start slots of the sums.

    Raises:
        ValueError: wrong shapes.
        DesignError: a reference that no input holds.
        TooLarge: more fourth moments than are computed, as of a controller with many states.
    """
    from design.whole_process import one_blas_thread

    sc, ca = as_chain(Lambda, "Lambda"), as_chain(Pi, "Pi")
    structure = loop_structure(
        A, B, C, sc, ca, selection, samples=samples, integral=1.0 if integral else 0.0, state_gains=state_gains
    )  # fmt: skip
    K = check_gains(gains, structure.gain_shape)
    n, p, m = structure.plant_order, np.shape(C)[0], structure.B.shape[2]
    r = _signal(reference, p, "reference", None)
    aim = r if target is None else _signal(target, p, "target", len(r))
    w = _signal(np.zeros((len(r), m)) if disturbance is None else disturbance, m, "disturbance", len(r))
    star = steady_state(A, B, C) if r.any() else None
    if star is not None and not held_exactly(A, B, C, r):
        raise DesignError("reference: no input holds it")
    f = _signal(np.zeros((len(r), n)) if drive is None else drive, n, "drive", len(r))
    output = np.asarray(C, dtype=np.float64)
    summed = np.zeros(p)
    summed[list(range(p) if tracked is None else tracked)] = 1.0
    walk = MomentRecursion(structure, K, (sc, ca), period_s, output, sums_from, summed)

    def ideal(value: Array) -> Array:
        """Steady closed-loop state at a constant reference."""
        if star is None:
            return np.zeros(structure.base.shape[-1])
        return np.concatenate([
            star.state @ value, np.tile(value, structure.stored_outputs), np.zeros(structure.own_states),
            np.tile(star.input @ value, structure.behind // m),
        ])  # fmt: skip

    start = -ideal(r[0])
    if x0 is not None:
        first = np.asarray(x0, dtype=np.float64)
        start[:n] += first
        start[n : n + structure.stored_outputs * p] += np.tile(output @ first, structure.stored_outputs)
    with one_blas_thread():
        walk.begin(start, _initial_modes(structure, sc, ca, initial))
        mean, variance, square, fourth = np.empty((len(r), p)), np.empty((len(r), p)), np.empty(len(r)), np.empty(len(r))
        for k in range(len(r)):
            if k and (r[k] != r[k - 1]).any():
                walk.jump(ideal(r[k - 1]) - ideal(r[k]))
            walk.aim(r[k] - aim[k])
            mean[k], variance[k], square[k], fourth[k] = walk.read()
            hold = np.zeros(m) if star is None else star.input @ r[k]
            walk.step(k, w[k], f[k], hold)
        sums = walk.sums()
    return Prediction(
        error_mean=mean,
        error_sd=np.sqrt(np.maximum(variance, 0.0)),
        square_mean=square,
        square_sd=np.sqrt(np.maximum(fourth - square**2, 0.0)),
        sum_mean=sums[0],
        sum_sd=np.sqrt(np.maximum(sums[1] - sums[0] ** 2, 0.0)),
    )


def _signal(values: npt.ArrayLike, width: int, name: str, length: int | None) -> Array:
    array = np.asarray(values, dtype=np.float64)
    array = array[:, None] if array.ndim == 1 else array
    if array.ndim != 2 or array.shape[1] != width or (length is not None and len(array) != length):
        raise FieldError(name, f"shape {array.shape}, expected ({length or 'K'}, {width})")
    if not np.isfinite(array).all():
        raise FieldError(name, "not finite")
    return array


def _initial_modes(
    structure: LoopStructure, sc: DelayChain, ca: DelayChain, initial: tuple[npt.ArrayLike, npt.ArrayLike] | None
) -> Array:
    """Distribution of the joint mode at k = 0; the C-A delay of the slot before counts as that of the first one."""
    laws = [sc.stationary, ca.stationary] if initial is None else [np.asarray(v, dtype=np.float64) for v in initial]
    for name, law, chain in zip(("initial[0]", "initial[1]"), laws, (sc, ca), strict=True):
        if law.shape != (chain.modes,) or (law < 0).any() or abs(law.sum() - 1.0) > 1e-9:
            raise FieldError(name, f"expected {chain.modes} probabilities that sum to 1")
    weights = laws[0][structure.sc_mode] * laws[1][structure.ca_mode]
    if structure.selection == "previous":  # of the modes that differ in the slot before only, one carries the weight
        every, weights = weights, np.zeros_like(weights)
        for s, c in set(zip(structure.sc_mode.tolist(), structure.ca_mode.tolist())):
            same = np.flatnonzero((structure.sc_mode == s) & (structure.ca_mode == c))
            chosen = same[np.argmin(np.abs(structure.ca_before[same] - c))]
            weights[chosen] = every[chosen]
    share = float(weights.sum())
    if not share > 0.0:
        raise FieldError("initial", "puts all on pairs of modes that never meet")
    return np.asarray(weights if share > 1.0 - 1e-9 else weights / share)  # pairs that are never met have none
