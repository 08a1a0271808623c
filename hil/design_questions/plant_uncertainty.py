"""What a design guarantees though parameters of the plant are known to a share only: (7.41) for a parameter's interval.

The discrete plants of all parameter values lie in [A + dA, B + dB], [dA dB] = M Delta [N1 N2], |Delta| <= 1: M and N are fitted
to a grid over the intervals, so that every plant of the grid has |Delta| <= 1, and Delta is widened by the second differences
of the grid for what lies between. Delta may change from slot to slot, so that parameters that drift are covered, too.

Where the small-gain theorem proves too little, one quadratic family per mode is sought at the ends of the intervals, and judged
on the whole grid and between its points.

Reference: thesis Remark 7.6; `design.networked_loop.uncertainty`, `design.networked_loop.polytope`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from design.errors import DesignError, Infeasible
from design.jump_linear import STABILITY_MARGIN
from design.jump_linear.second_moment import cost_once
from design.networked_loop.affine_loop import LoopStructure
from design.networked_loop.polytope import MOST_UNKNOWNS, Growth, quadratic_growth
from design.networked_loop.uncertainty import robust_norms, uncertainty_margin
from design.tracking.robust_synthesis import robust
from design.tracking.synthesis import Design, Progress
from design.verdict import State, Verdict, digest
from design.whole_process import one_blas_thread
from hil.design_questions import TrackingTarget, digest_of_design, on_plant
from hil.errors import HilError, located
from plants.errors import PlantError
from plants.parts.protocols import MovesOtherwise, Plant

Array = NDArray[np.float64]
FAMILY = "one quadratic family per mode, over the ends of the intervals and all plants between (semidefinite program)"
GROWTH = "largest factor by which the family grows in a slot"
NOMINAL_STEP = (
    "a step of the reference counts in the norms as that of the nominal plant; the offset that another plant keeps after it is in"
    " none of them"
)
GRID = {1: 33, 2: 13, 3: 7}
"""Points per parameter, by the number of parameters."""


class Interval(NamedTuple):
    """A parameter of the plant, its nominal value, and the ends between which it may lie."""

    name: str
    nominal: float
    low: float
    high: float


class PlantSet(NamedTuple):
    """M (n, a), N1 (b, n), N2 (b, m) that cover the plants; the grid they were fitted to, its ends and second differences."""

    M: Array
    N1: Array
    N2: Array
    changes: Array
    ends: Array
    bends: tuple[Array, ...]


def interval(plant: Plant, said: str) -> Interval:
    """Return what ``name=10%`` (a share of the nominal value) or ``name=0.2`` (to either side) says of a plant's parameter.

    ``A.1.0=10%`` says it of an entry of a matrix.

    Raises:
        HilError: no such parameter, or no width above 0.
    """
    name, _, width = (part.strip() for part in said.partition("="))
    try:
        number = float(width.removesuffix("%"))
    except ValueError:
        number = np.nan
    if not (np.isfinite(number) and number > 0):
        raise HilError(f"--uncertainty {said}: expected NAME=PERCENT% or NAME=WIDTH, above 0, as in gain=10%")
    known = parameters(plant)
    if name not in known:
        raise HilError(f"--uncertainty: {name}: the plant has no such number (there are: {', '.join(sorted(known)) or 'none'})")
    nominal = known[name]
    half = abs(nominal) * number / 100.0 if width.endswith("%") else number
    if half == 0.0:
        raise HilError(f"--uncertainty: {name}: is 0, so every percentage of it is 0; give a width, as in {name}=0.1")
    return Interval(name, nominal, nominal - half, nominal + half)


def parameters(plant: Plant) -> dict[str, float]:
    """Return the numbers among a plant's own parameters, by name; those of a list or matrix by their places, as in ``A.1.0``."""
    if not dataclasses.is_dataclass(plant):
        return {}
    found: dict[str, float] = {}

    def take(name: str, value: object) -> None:
        if isinstance(value, float | int) and not isinstance(value, bool):
            found[name] = float(value)
        elif isinstance(value, tuple | list):
            for i, entry in enumerate(value):
                take(f"{name}.{i}", entry)

    for field in dataclasses.fields(plant):
        take(field.name, getattr(plant, field.name))
    return found


def _changed(of: Any, at: Sequence[str], value: float) -> Any:
    """A value with another number at a place within it."""
    if not at:
        return value
    i = int(at[0])
    return (*of[:i], _changed(of[i], at[1:], value), *of[i + 1 :])


def plants_between(target: TrackingTarget, design: Design, intervals: Sequence[Interval]) -> PlantSet:
    """Return matrices that cover the discrete plants of all parameters in their intervals, as tight as suits a design's loop.

    Raises:
        HilError: more than three parameters, one named twice, or a value that the plant refuses.
    """
    names = [i.name for i in intervals]
    if not 1 <= len(set(names)) == len(names) <= max(GRID):
        raise HilError(f"--uncertainty: {', '.join(names)}; expected one to {max(GRID)} parameters, each once")
    count = GRID[len(names)]
    axes = [np.linspace(i.low, i.high, count).tolist() for i in intervals]
    nominal = _discrete(target, {}, names)
    points = [_discrete(target, dict(zip(names, values)), names) - nominal for values in product(*axes)]
    n, width = nominal.shape
    changes = np.array(points)
    if not changes.any():
        raise HilError(f"--uncertainty: {', '.join(names)}: the plant's model does not depend on it")
    down, across = _felt(design, np.abs(changes).max(axis=0))  # what is small in its unit is not rounding
    alike = changes / down[:, None] / across
    left, row_size, _ = np.linalg.svd(alike.transpose(1, 0, 2).reshape(n, -1), full_matrices=False)
    _, column_size, right = np.linalg.svd(alike.reshape(-1, width), full_matrices=False)
    rows, columns = row_size > 1e-12 * row_size[0], column_size > 1e-12 * column_size[0]
    M = left[:, rows] * np.sqrt(row_size[rows])
    N = np.sqrt(column_size[columns])[:, None] * right[columns]
    delta = np.linalg.pinv(M) @ alike @ np.linalg.pinv(N)
    grid = delta.reshape(*[count] * len(names), *delta.shape[1:])
    between = sum(float(np.linalg.norm(np.diff(grid, 2, axis=axis), 2, axis=(-2, -1)).max()) for axis in range(len(names)))
    largest = float(np.linalg.norm(delta, 2, axis=(-2, -1)).max()) + between
    spread = changes.reshape(*[count] * len(names), n, width)
    bends = tuple(np.diff(spread, 2, axis=axis).reshape(-1, n, width) for axis in range(len(names)))
    ends, N = spread[np.ix_(*[[0, -1]] * len(names))].reshape(-1, n, width), N * across
    return PlantSet(down[:, None] * M * largest, N[:, :n], N[:, n:], changes, ends, bends)


def _felt(design: Design, most: Array) -> tuple[Array, Array]:
    r"""Units of rows and columns of [A B] in which entries count by what the loop makes of their errors, (n,) and (n + m,).

    An impulse at x_j moves state and input q by g_qj in the root mean square. Errors up to a of the entries make W v = a g v of
    an error v of the state. In the units v of rows and g v of columns, with the Perron vector v, the product of both norms (of
    largest row sums) is the least that units can make it, and the same whatever the plant's own units are. A thousandth of
    the way from the disturbance to z, as if it were closed, joins parts of the loop that do not move each other.
    """
    structure = design.problem.structure()
    A, B, C, _, transition = structure.system(design.gains).matrices
    n, alpha = structure.plant_order, design.problem.alpha(structure)
    states = np.broadcast_to(np.eye(n, A.shape[-1]), (len(A), n, A.shape[-1]))
    shown = np.concatenate([states, structure.applied_input(design.gains), C], axis=1)
    cost = np.nan_to_num(cost_once(A, transition, np.einsum("iqj,iqk->qijk", shown, shown)))
    of_state = np.einsum("i,qijj->qj", alpha, np.maximum(cost, 0.0))[:, :n]
    of_input, width = np.einsum("i,qijk,ijm,ikm->q", alpha, cost, B, B), len(most.T)
    of_input[n:width] += 1.0  # itself
    closed = np.outer(np.sqrt(of_input[:width]), np.sqrt(of_state[width:].sum(axis=0))) / np.sqrt(of_input[width:].sum() or 1.0)
    moved = np.sqrt(of_state[:width]) + 1e-3 * closed
    rates, vectors = np.linalg.eig(most @ moved)
    down = np.abs(vectors[:, rates.real.argmax()])
    across = moved @ down
    return np.where(down > 0.0, down, 1.0), 1.0 / np.where(across > 0.0, across, 1.0)


def _discrete(target: TrackingTarget, values: dict[str, float], names: Sequence[str]) -> Array:
    """[A B] of the plant with other values of its parameters, as it moves; without any, of its model; (n, n + m)."""
    with located("--uncertainty", PlantError, ValueError):
        changed: Any = target.of
        for name, value in values.items():
            field, *at = name.split(".")
            changed = dataclasses.replace(changed, **{field: _changed(getattr(changed, field), at, value)})
        moves = changed.motion() if values and isinstance(changed, MovesOtherwise) else changed.model()
        found = moves.discretise(target.period_s)
    if not np.array_equal(found.C, target.C):
        said = "changes what the plant measures (C); how it moves alone may be uncertain"
        raise HilError(f"--uncertainty: {', '.join(names)}: {said}")
    return np.hstack([np.asarray(found.A, dtype=np.float64), np.asarray(found.B, dtype=np.float64)])


def judge_uncertain(target: TrackingTarget, design: Design, intervals: Sequence[Interval]) -> Verdict:
    """Return the verdict on a design over all plants whose parameters lie in their intervals.

    Args:
        target: the plant and its network.
        design: the gains.
        intervals: the parameters.

    Raises:
        HilError: see `plants_between`.
    """
    structure, gains = design.problem.structure(), design.gains
    found = plants_between(target, design, intervals)
    with one_blas_thread():
        margin = uncertainty_margin(structure, gains, found.M, found.N1, found.N2)
        worst = max(_radius(target, design, change) for change in found.ends)
        proved = structure.between is None and margin > 1.0
        growth = "" if proved or worst >= 1.0 else _growth(structure, gains, found)
        details: dict[str, object] = {
            "parameters": [i._asdict() for i in intervals],
            "margin": margin if np.isfinite(margin) else None,
            "worst_radius_at_the_ends": worst,
            "growth_of_one_family": None if isinstance(growth, str) else growth.factor,
            "M": found.M.tolist(), "N1": found.N1.tolist(), "N2": found.N2.tolist(), "h2_norm": None, "hinf_norm": None,
        }  # fmt: skip
        state, reason = _decided(structure, margin, worst, growth)
        if state == "certified" and proved:
            try:
                norms = robust_norms(structure, gains, found.M, found.N1, found.N2, design.problem.initial)
                details |= {"h2_norm": norms.h2, "hinf_norm": norms.hinf}
            except Infeasible as error:  # stable, but no bound was found
                reason = f"{reason}; {error}"
    family = growth if state == "certified" and isinstance(growth, Growth) else None
    system = {"loop": digest_of_design(target, design), "parameters": [list(i) for i in intervals]}
    verdict = Verdict(
        kind="mean-square stability", state=state, reason=reason, limit=1.0, details=details, digest=digest(system),
        number=family.factor if family else 1.0 / margin,
        quantity=GROWTH if family else "share of the uncertainty that the loop bears, inverse",
        method=FAMILY if family else "small-gain theorem over the jump-linear loop (Remark 7.6)",
        assumptions=(
            f"the plant between two of {len(found.changes)} computed ones changes as smoothly as they do",
            "no packet is later than its law says", "no limit trips",
            *([NOMINAL_STEP] if design.problem.reference_weight and details["h2_norm"] is not None else []),
        ),
    )  # fmt: skip
    return on_plant(target, verdict)


def robust_design(
    target: TrackingTarget, design: Design, intervals: Sequence[Interval], progress: Progress | None = None
) -> Design:
    """Return the design with gains of least guaranteed H2 norm over all plants whose parameters lie in their intervals.

    Args:
        target, intervals: as `judge_uncertain` takes them.
        design: of the nominal plant, where the search begins.
        progress: of the search.

    Raises:
        HilError: see `plants_between`; a sojourn law whose tail is cut.
        NotStable: the gains found have no certificate.
    """
    if design.problem.structure().between is not None:
        raise HilError("--robust: guaranteed norms are not computed over a sojourn law whose tail is cut")
    found = plants_between(target, design, intervals)
    with one_blas_thread():
        return robust(design, found.M, found.N1, found.N2, progress=progress)


def _radius(target: TrackingTarget, design: Design, change: Array) -> float:
    A, B = np.split(np.hstack([target.A, target.B]) + change, [len(target.A)], axis=1)
    return float(dataclasses.replace(design.problem, A=A, B=B).structure().system(design.gains).radius())


def _growth(structure: LoopStructure, gains: Array, found: PlantSet) -> Growth | str:
    """How much one family grows in a slot, or in words why that is not known."""
    try:
        growth = quadratic_growth(structure, gains, found.changes, found.ends, found.bends)
    except np.linalg.LinAlgError:
        return "so near the edge no quadratic family is computed"
    except DesignError as error:  # without the solver
        return str(error)
    return growth or f"a quadratic family has more than {MOST_UNKNOWNS} unknowns here, and is not sought"


def _decided(structure: LoopStructure, margin: float, worst: float, growth: Growth | str) -> tuple[State, str]:
    if worst > 1.0 + STABILITY_MARGIN:
        return "refused", f"the second-moment radius is {worst:.5g} at an end of the intervals, expected below 1"
    if structure.between is None and margin > 1.0:
        return "certified", f"the loop is mean-square stable for all plants between, and up to {margin:.3g} times the uncertainty"
    if isinstance(growth, Growth) and growth.factor < 1.0 - STABILITY_MARGIN:
        return "certified", (
            "the loop is mean-square stable for all plants between: one quadratic family per mode, found at "
            f"{growth.vertices} plants, grows by at most {growth.factor:.5g} in a slot"
        )
    if structure.between is not None:
        less = "the small-gain theorem is not computed over a sojourn law whose tail is cut"
    else:
        less = f"the small-gain theorem proves {100.0 * margin:.3g} % of the uncertainty only"
    if isinstance(growth, str):
        return "undecided", f"{less}; {growth}"
    return "undecided", f"{less}, and no quadratic family was found that falls over all plants (the best: {growth.factor:.4g})"
