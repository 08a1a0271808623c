"""The cells of one sojourn clock, or of two, on which a Lyapunov function is linear, with the rate vertices that hold there.

A cell is [h_r, h_{r+1}) of one mode, the last one [h_R, inf). Within it every rate stays between its bounds, so that an
inequality that is affine in the rates holds if it holds at all 2^(N-1) corners of the box.

Products of two functions that are linear in h are quadratic; they are negative definite on the cell if their three
Bernstein coefficients are. Conditions on P are made by `along_cells`, conditions on X = P^-1 by `require_inverse`.

References: thesis (2.13), (4.14), (4.26); ERRATA 1, 3 and 12.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, cast

import numpy as np
from msgspec import Struct

from design.controllers.scheduled_gain import ScheduledGain, tabulated
from design.errors import FieldError
from design.lmi import Lift, as_float
from design.lmi.program import Array, Inequality, LmiProgram, add_schur_rows, symmetric_blocks
from design.processes.partitions import Partition, check_partition
from design.processes.semi_markov import FaultDetection, SemiMarkov


class Cell(Struct, frozen=True, kw_only=True):
    """One cell of one mode.

    Args:
        mode, index: where it belongs.
        start, stop: its ends (s); ``stop`` is ``inf`` in the last one.
        rates: the vertices of the rates out of the mode, each of length N (1/s).
    """

    mode: int
    index: int
    start: float
    stop: float
    rates: tuple[tuple[float, ...], ...]

    @property
    def last(self) -> bool:
        """Whether the cell never ends."""
        return math.isinf(self.stop)

    def landing(self, sections: int, *, sound: bool) -> int:
        """The section in which a jump lands in a mode with so many: the first; as printed, the one that it left (not sound)."""
        return 0 if sound else min(self.index, sections - 1)


def cells(process: SemiMarkov, nodes: Partition, *, sound: bool = True) -> list[Cell]:
    """All cells between the nodes, mode by mode.

    ``sound=False`` takes only the two corners "all low" and "all high": a segment of the box when a mode has two targets or more.

    Raises:
        ValueError: the nodes are not increasing from 0, or a rate has no finite bound on a cell.
    """
    check_partition(process, nodes)
    out = []
    for mode, row in enumerate(nodes):
        for index, (start, stop) in enumerate(zip(row, [*row[1:], math.inf])):
            low, high = process.bounds(mode, start, stop)
            for target, (a, b) in enumerate(zip(low.tolist(), high.tolist())):
                if not math.isfinite(b):
                    raise FieldError(f"rates[{mode}][{target}]", f"no finite bound on [{start:g}, {stop:g}) s; clip it")
                if not 0 <= a <= b:
                    raise FieldError(f"rates[{mode}][{target}]", f"bounds [{a:g}, {b:g}] on [{start:g}, {stop:g}) s cross")
            corners = {tuple(low.tolist()), tuple(high.tolist())}
            if sound:
                corners = set(itertools.product(*({a, b} for a, b in zip(low.tolist(), high.tolist()))))
            out.append(Cell(mode=mode, index=index, start=start, stop=stop, rates=tuple(sorted(corners))))
    return out


def refine(process: SemiMarkov, starts: Partition, parts: int) -> Partition:
    """Lyapunov nodes: the section starts, the kinks of the rates and where they settle, every gap cut into ``parts``."""
    if parts < 1:
        raise FieldError("parts", f"{parts}, expected at least 1")
    out = []
    for mode, row in enumerate(starts):
        settled = process.settled(mode)
        ends = {*row, *process.breaks(mode), *({settled} if math.isfinite(settled) else set())}
        edges = sorted(ends)
        inner = [np.linspace(a, b, parts + 1)[:-1].tolist() for a, b in itertools.pairwise(edges)]
        out.append(tuple(itertools.chain(*inner, edges[-1:])))
    return tuple(out)


def gain_on(gain: ScheduledGain, cell: Cell, lift: Lift) -> list[Array]:
    """K at both ends of a cell along which it is linear; one matrix where it is held.

    Raises ValueError where a section of the gains starts inside the cell: K would not be linear on it.
    """
    starts, stored = gain.starts_s[cell.mode], gain.gain[cell.mode]
    if ((starts > cell.start) & (starts < cell.stop)).any():
        raise FieldError(f"nodes[{cell.mode}]", f"a section of the gains starts inside [{cell.start:g}, {cell.stop:g}) s")
    section = int(np.searchsorted(starts, cell.start, side="right")) - 1
    if gain.schedule == "hold" or section + 1 == starts.size:
        return [lift(stored[section])]
    parts = [float((h - starts[section]) / (starts[section + 1] - starts[section])) for h in (cell.start, cell.stop)]
    return [np.asarray(lift(1.0 - part) * lift(stored[section]) + lift(part) * lift(stored[section + 1])) for part in parts]


def bernstein(gains: Sequence[Array], ends: int) -> list[list[tuple[int, Array]]]:
    """What to check on a cell for g(s) = f(P(s), K(s)), P and K linear in s and f affine in each of them.

    The Bernstein coefficients are f(P_0, K_0), f(P_1, K_1) and (f(P_0, K_1) + f(P_1, K_0)) / 2; each is returned as the
    list of (end of P, K) whose mean it is. Where K does not move, the middle one follows from the ends.
    """
    out = [[(end, gains[min(end, len(gains) - 1)])] for end in range(ends)]
    return [*out, [(0, gains[1]), (1, gains[0])]] if len(gains) > 1 else out


Change = Callable[..., Any]
"""(cell, K, what P itself changes by per second, P, what else lies at the nodes, what all cells share) to the left side."""


def along_cells(
    changes: Sequence[Change],
    process: SemiMarkov,
    gain: ScheduledGain,
    nodes: Partition,
    method: str,
    *,
    at_nodes: Sequence[str] = ("P",),
    shared: Sequence[str] = (),
    least: Array | None = None,
    sound: bool = True,
    lift: Lift = as_float,
) -> list[Inequality]:
    """What must be negative definite along every cell at every corner of the rates, and what links the cells of ``pwc``.

        dP_i/dh + sum_j lambda_ij (P_j(0) - P_i) is handed to each of ``changes`` beside P_i(h) and K(i, h),

    on P[i,r] and the names below, P linear between the nodes (``pwl``) or constant per section (``pwc``).

    Args:
        changes: left sides, affine in P and in K, that must all hold, as at the vertices of an uncertainty.
        process: the rates.
        gain: K(i, h).
        nodes: nodes or sections of P per mode.
        method: ``pwl`` or ``pwc``.
        at_nodes: "P", and other matrices that lie at the same nodes.
        shared: matrices of all cells.
        least: every P is at least this; None: positive definite.
        sound: as it holds; else as Chapter 2 prints it: two corners of the rates, jumps that land in the section that they left,
            and sections that are not linked, which proves nothing.
        lift: into floats or fractions.

    Raises:
        ValueError: as ``cells``; a gain that varies within a section of ``pwc``.
    """
    out, floor = [], 0 if least is None else least
    for cell in cells(process, nodes, sound=sound):
        i, here = cell.mode, cell.index
        gains, pwl = gain_on(gain, cell, lift), method == "pwl" and not cell.last
        if len(gains) > 1 and not pwl:
            raise FieldError("gain", f"varies within the section at {cell.start:g} s; only method 'pwl' can follow it")
        own = [f"{kind}[{i},{r}]" for kind in at_nodes for r in ([here, here + 1] if pwl else [here])]
        for rates in cell.rates:
            targets = [j for j, rate in enumerate(rates) if rate > 0]
            on = (*own, *shared, *(f"P[{j},{cell.landing(len(nodes[j]), sound=sound)}]" for j in targets))
            for pairs, one in itertools.product(bernstein(gains, 1 + pwl), changes):
                function = partial(
                    _mean_of_ends, change=partial(one, cell), kinds=len(at_nodes), shared=len(shared), lift=lift, pairs=pairs,
                    width=lift(cell.stop) - lift(cell.start) if pwl else None, rates=[lift(rates[j]) for j in targets],
                )  # fmt: skip
                name = f"decrease of mode {i} on [{cell.start:g}, {cell.stop:g}) s at rates {rates}"
                out.append(Inequality(name=name, function=function, on=on))
        if method == "pwc" and sound and not cell.last:
            both = (f"P[{i},{here + 1}]", f"P[{i},{here}]")
            out.append(Inequality(name="{} <= {}".format(*both), function=lambda a, b: a - b, on=both))
        name = f"P[{i},{here}] {'> 0' if least is None else 'normalised'}"
        out.append(Inequality(name=name, function=lambda p: floor - p, on=(f"P[{i},{here}]",), strict=least is None))
    return out


def _mean_of_ends(
    *matrices: Array,
    change: Change,
    kinds: int,
    shared: int,
    lift: Lift,
    pairs: list[tuple[int, Array]],
    width: Array | None,
    rates: list[Array],
) -> Array:
    """One Bernstein coefficient; ``matrices``: those at the nodes kind by kind, shared, landings."""
    ends = (len(matrices) - shared - len(rates)) // kinds
    at, rest = matrices[: kinds * ends], matrices[kinds * ends :]
    slope = 0 * at[0] if width is None else (at[1] - at[0]) / width
    terms = []
    for end, k in pairs:
        flow = slope + sum(rate * (after - at[end]) for rate, after in zip(rates, rest[shared:]))
        terms.append(change(k, flow, *at[end::ends], *rest[:shared]))
    return cast(Array, sum(terms[1:], terms[0]) / lift(len(terms)))


def require_inverse(
    program: LmiProgram,
    blocks: Sequence[Change],
    process: SemiMarkov,
    nodes: Partition,
    method: str,
    *,
    at_nodes: Sequence[str],
    shared: Sequence[str] = (),
    sound: bool = True,
) -> None:
    """Require along every cell, at every corner of the rates, what is linear in X = P^-1 and in products with it.

        (rows of the block)  and  [sqrt(lambda_ij) X_i, 0, -X_j(0)],    - dX_i/dh - sum_j lambda_ij X_i in the first corner.

    Args:
        program: with X[i,r] and the matrices below.
        blocks: (cell, X, what else lies at the node, what all cells share) to the lower block triangle; each must hold.
        process, nodes, method, sound: as of ``along_cells``.
        at_nodes: matrices at the nodes of X.
        shared: matrices of all cells.
    """
    for cell in cells(process, nodes, sound=sound):
        i, here = cell.mode, cell.index
        pwl = method == "pwl" and not cell.last
        for rates in cell.rates:
            targets = [j for j, rate in enumerate(rates) if rate > 0]
            landing = [f"X[{j},{cell.landing(len(nodes[j]), sound=sound)}]" for j in targets]
            for end, block in itertools.product(range(1 + pwl), blocks):
                function = partial(
                    _with_jumps, block=partial(block, cell), end=end, width=cell.stop - cell.start if pwl else None,
                    rates=[rates[j] for j in targets],
                )  # fmt: skip
                on = (f"X[{i},{here + r}]" for r in range(1 + pwl))
                own = (f"{kind}[{i},{here + end}]" for kind in at_nodes)
                program.require(f"decrease of mode {i} from {cell.start:g} s at {rates}", function, *on, *own, *shared, *landing)
        if method == "pwc" and sound and not cell.last:
            program.require("coupling", lambda a, b: b - a, f"X[{i},{here + 1}]", f"X[{i},{here}]", strict=False)


def _with_jumps(*matrices: Array, block: Change, end: int, width: float | None, rates: list[float]) -> Array:
    """The block at one end of a cell with the rows of its jumps; ``matrices``: X at the ends, others, landings."""
    x, rest = matrices[end], matrices[1 if width is None else 2 : len(matrices) - len(rates)]
    rows = cast(list[list[Array | None]], block(x, *rest))
    slope = 0.0 if width is None else (matrices[1] - matrices[0]) / width
    rows[0][0] = cast(Array, rows[0][0]) - sum(rates) * x - slope
    add_schur_rows(rows, (math.sqrt(rate) * x for rate in rates), matrices[len(matrices) - len(rates) :])
    return symmetric_blocks(rows)


def pair_cells(process: FaultDetection, eta_nodes: Partition, r_nodes: Partition) -> list[tuple[Cell, Cell]]:
    """All pairs of a section of eta's clock and one of r's. Raises ValueError as ``cells``."""
    return [(eta, r) for eta in cells(process.failure, eta_nodes) for r in cells(process.detection[eta.mode], r_nodes)]


def pair_corners(process: FaultDetection, eta: Cell, r: Cell) -> Iterator[list[tuple[float, tuple[int, int, int, int]]]]:
    """At every corner of both boxes the rates above 0 (1/s), each with (eta, r, section of eta, section of r) after its jump."""
    after = 0 if process.failure_restarts_detection_clock else r.index
    for failure, detection in itertools.product(eta.rates, r.rates):
        jumps = [(rate, (j, r.mode, 0, after)) for j, rate in enumerate(failure) if rate > 0]
        yield jumps + [(rate, (eta.mode, l, eta.index, 0)) for l, rate in enumerate(detection) if rate > 0]


def bounded_gains(
    matrices: Mapping[str, Array], product: str, sections: Partition, bound: float, measured: tuple[str, ...] = ("r",)
) -> ScheduledGain:
    """The gains ``product`` X^-1 of matrices "X[mode,section]", each cut to a norm of at most ``bound``."""
    tables = []
    for mode, row in enumerate(sections):
        gains = [matrices[f"{product}[{mode},{r}]"] @ np.linalg.inv(matrices[f"X[{mode},{r}]"]) for r in range(len(row))]
        tables.append([(start, gain * min(1.0, bound / float(np.linalg.norm(gain, 2)))) for start, gain in zip(row, gains)])
    return tabulated(tables, measured=measured)
