"""The cells of two sojourn clocks, of the failure eta and of the detection r: a section of each, and the rates that hold there.

Reference: thesis (4.14), (4.26); ERRATA 12.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

from design.processes.partitions import Partition
from design.processes.semi_markov import FaultDetection
from design.semi_markov_loop.sojourn_grid import cells


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
