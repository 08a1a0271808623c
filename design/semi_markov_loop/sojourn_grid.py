"""The cells of one sojourn clock, or of two, on which a Lyapunov function is linear, with the rate vertices that hold there.

A cell is [h_r, h_{r+1}) of one mode, the last one [h_R, inf). Within it every rate stays between its bounds, so that an
inequality that is affine in the rates holds if it holds at all 2^(N-1) corners of the box.

Products of two functions that are linear in h are quadratic; they are negative definite on the cell if their three
Bernstein coefficients are (``along``).

References: thesis (2.13), (4.14), (4.26); ERRATA 1, 3 and 12.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from design.controllers.scheduled_gain import ScheduledGain, tabulated
from design.errors import FieldError
from design.lmi.program import Inequality
from design.processes.partitions import Partition, check_partition
from design.processes.semi_markov import FaultDetection, SemiMarkov

Array = npt.NDArray[Any]
Lift = Callable[[npt.ArrayLike], Array]


def as_float(value: npt.ArrayLike) -> Array:
    """The lift that changes nothing: numbers stay floats (the other lift makes fractions, ``design.lmi.exact``)."""
    return np.asarray(value, dtype=float)


@dataclass(frozen=True, slots=True, kw_only=True)
class Coupling:
    """How inequalities of different cells hang together. The defaults are what holds; anything else proves nothing.

    Args:
        all_corners: every corner of the box of rates, or only "all low" and "all high": a segment of it.
        lands_first: a jump lands in the first section of the next mode, or in the section that it left.
        linked: P falls where a new section begins.
    """

    all_corners: bool = True
    lands_first: bool = True
    linked: bool = True

    def landing(self, section: int, sections: int) -> int:
        """The section in which a jump from ``section`` lands in a mode with ``sections`` of them."""
        return 0 if self.lands_first else min(section, sections - 1)


SOUND = Coupling()


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
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


def cells(process: SemiMarkov, nodes: Partition, *, all_corners: bool = True) -> list[Cell]:
    """All cells between the nodes, mode by mode.

    ``all_corners=False`` takes only the two corners "all low" and "all high": a segment of the box when a mode has two targets
    or more.

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
            if not all_corners:
                corners = {tuple(low.tolist()), tuple(high.tolist())}
            else:
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


@dataclass(frozen=True, slots=True, kw_only=True)
class GainOnCell:
    """K along a cell as a mixture of stored gains: K at end e is sum_s weights[e][s] gain[mode, sections[s]]."""

    sections: tuple[int, ...]
    weights: tuple[tuple[float, ...], ...]

    @property
    def moves(self) -> bool:
        """Whether K changes along the cell."""
        return self.weights[0] != self.weights[-1]


def gain_on(starts: npt.NDArray[np.float64], schedule: str, cell: Cell) -> GainOnCell:
    """The stored gains that act on a cell, with their weights at its ends (one end if the cell never ends).

    Raises ValueError where a section of the gains starts inside the cell: K would not be linear on it.
    """
    if ((starts > cell.start) & (starts < cell.stop)).any():
        raise FieldError(f"nodes[{cell.mode}]", f"a section of the gains starts inside [{cell.start:g}, {cell.stop:g}) s")
    section = int(np.searchsorted(starts, cell.start, side="right")) - 1
    ends = 1 if cell.last else 2
    if schedule == "hold" or section + 1 == starts.size:
        return GainOnCell(sections=(section,), weights=((1.0,),) * ends)
    width = starts[section + 1] - starts[section]
    parts = [float((h - starts[section]) / width) for h in (cell.start, cell.stop)[:ends]]
    return GainOnCell(sections=(section, section + 1), weights=tuple((1.0 - part, part) for part in parts))


def bernstein(gain: GainOnCell) -> list[list[tuple[int, tuple[float, ...]]]]:
    """What to check on a cell for g(s) = f(P(s), K(s)), P and K linear in s and f affine in each of them.

    The Bernstein coefficients are f(P_0, K_0), f(P_1, K_1) and (f(P_0, K_1) + f(P_1, K_0)) / 2; each is returned as the
    list of (end of P, weights of K) whose mean it is. Where K does not move, the middle one follows from the ends.
    """
    ends = [[(end, weights)] for end, weights in enumerate(gain.weights)]
    return [*ends, [(0, gain.weights[1]), (1, gain.weights[0])]] if gain.moves else ends


Change = Callable[..., Array]
"""(cell, K, what P itself changes by per second, P, what else lies at the nodes, what all cells share) to the left side."""


def along_cells(
    change: Change | Sequence[Change],
    process: SemiMarkov,
    gain: ScheduledGain,
    nodes: Partition,
    method: str,
    *,
    at_nodes: Sequence[str] = ("P",),
    shared: Sequence[str] = (),
    coupling: Coupling = SOUND,
    lift: Lift = as_float,
) -> list[Inequality]:
    """What must be negative definite along every cell at every corner of the rates, and what links the cells of ``pwc``.

        dP_i/dh + sum_j lambda_ij (P_j(0) - P_i) is handed to ``change`` beside P_i(h) and K(i, h),

    on P[i,r] and the names below, P linear between the nodes (``pwl``) or constant per section (``pwc``).

    Args:
        change: the left side, affine in P and in K; or several that must hold, as of vertices.
        process: the rates.
        gain: K(i, h).
        nodes: nodes or sections of P per mode.
        method: ``pwl`` or ``pwc``.
        at_nodes: "P", and other matrices that lie at the same nodes.
        shared: matrices of all cells.
        coupling: how cells hang together.
        lift: into floats or fractions.

    Raises:
        ValueError: as ``cells``; a gain that varies within a section of ``pwc``.
    """
    out = []
    for cell in cells(process, nodes, all_corners=coupling.all_corners):
        i, here = cell.mode, cell.index
        mixture = gain_on(gain.starts_s[i], gain.schedule, cell)
        pwl = method == "pwl" and not cell.last
        if mixture.moves and not pwl:
            raise FieldError("gain", f"varies within the section at {cell.start:g} s; only method 'pwl' can follow it")
        own = [f"{kind}[{i},{r}]" for kind in at_nodes for r in ([here, here + 1] if pwl else [here])]
        stored = [lift(gain.gain[i, s]) for s in mixture.sections]
        checks = bernstein(mixture) if pwl else [[(0, mixture.weights[0])]]
        for rates in cell.rates:
            targets = [j for j, rate in enumerate(rates) if rate > 0]
            on = (*own, *shared, *(f"P[{j},{coupling.landing(here, len(nodes[j]))}]" for j in targets))
            for pairs, one in itertools.product(checks, [change] if callable(change) else change):
                function = partial(
                    _mean_of_ends, change=partial(one, cell), kinds=len(at_nodes), shared=len(shared), lift=lift,
                    pairs=[(end, np.asarray(sum(lift(w) * k for w, k in zip(weights, stored)))) for end, weights in pairs],
                    width=lift(cell.stop) - lift(cell.start) if pwl else None, rates=[lift(rates[j]) for j in targets],
                )  # fmt: skip
                name = f"decrease of mode {i} on [{cell.start:g}, {cell.stop:g}) s at rates {rates}"
                out.append(Inequality(name=name, function=function, on=on))
        if method == "pwc" and coupling.linked and not cell.last:
            both = (f"P[{i},{here + 1}]", f"P[{i},{here}]")
            out.append(Inequality(name="{} <= {}".format(*both), function=lambda a, b: a - b, on=both))
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


@dataclass(frozen=True, slots=True, kw_only=True)
class PairCell:
    """One pair of sections: eta = i in section a of its clock, r = k in section b of its; rate vertices (1/s)."""

    i: int
    k: int
    a: int
    b: int
    failure: tuple[tuple[float, ...], ...]
    detection: tuple[tuple[float, ...], ...]
    last_a: bool
    last_b: bool

    @property
    def vertices(self) -> Iterator[tuple[tuple[float, ...], tuple[float, ...]]]:
        """All pairs of rate vertices."""
        return itertools.product(self.failure, self.detection)


def pair_cells(process: FaultDetection, eta_nodes: Partition, r_nodes: Partition) -> list[PairCell]:
    """All pairs of sections. Raises ValueError as ``design.semi_markov_loop.sojourn_grid.cells``."""
    return [
        PairCell(
            i=one.mode, k=two.mode, a=one.index, b=two.index, failure=one.rates, detection=two.rates, last_a=one.last,
            last_b=two.last,
        )
        for one in cells(process.failure, eta_nodes)
        for two in cells(process.detection[one.mode], r_nodes)
    ]  # fmt: skip


def bounded_gains(
    matrices: Mapping[str, Array], product: str, sections: Partition, bound: float, measured: tuple[str, ...] = ("r",)
) -> ScheduledGain:
    """The gains ``product`` X^-1 of matrices "X[mode,section]", each cut to a norm of at most ``bound``."""
    tables = []
    for mode, row in enumerate(sections):
        gains = [matrices[f"{product}[{mode},{r}]"] @ np.linalg.inv(matrices[f"X[{mode},{r}]"]) for r in range(len(row))]
        tables.append([(start, gain * min(1.0, bound / float(np.linalg.norm(gain, 2)))) for start, gain in zip(row, gains)])
    return tabulated(tables, measured=measured)
