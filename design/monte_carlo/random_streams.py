"""One stream of random numbers per run, addressed by (seed, run, draw): the same for every split of the runs.

The streams are cut out of one counter-based generator (Philox4x64-10, numpy's). A run owns ``blocks`` consecutive
values of the counter's lowest word; the second word counts pages, for runs that need more; the third says what the
numbers are for:

    counter = (run * blocks + b, page, purpose, 0),   key = SeedSequence(seed),   4 numbers of 64 bits per value.

So the streams of consecutive runs are consecutive output, which one call fetches for a whole batch: making a generator
for every run (SeedSequence.spawn) costs 15 us a run, which is more than the run itself takes.

``random_raw`` is used and not a Generator method, because numpy promises the former's output for ever.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from design.errors import FieldError

FloatArray = npt.NDArray[np.float64]

JUMPS, PARAMETERS, CHAIN, NOISE = range(4)
"""What a stream is for."""


def uniforms(seed: int, first: int, runs: int, *, blocks: int, purpose: int, page: int = 0) -> FloatArray:
    """Uniform numbers of the runs first, ..., first + runs - 1: shape (4 blocks, runs), all strictly between 0 and 1.

    >>> whole = uniforms(7, 0, 100, blocks=2, purpose=JUMPS)
    >>> bool((whole[:, 60:63] == uniforms(7, 60, 3, blocks=2, purpose=JUMPS)).all())
    True
    """
    if seed < 0:
        raise FieldError("seed", f"{seed} is negative")
    if first < 0 or runs < 0:
        raise FieldError("runs", f"{runs} from number {first}, expected numbers >= 0")
    key = np.random.SeedSequence(seed).generate_state(2, np.uint64)
    counter = np.array([first * blocks, page, purpose, 0], dtype=np.uint64)
    raw = np.random.Philox(key=key, counter=counter).random_raw(4 * blocks * runs)
    # 52 bits and a half: never 0 and never 1, so that logarithms and normal quantiles stay finite.
    unit = ((raw >> np.uint64(12)) + 0.5) * 2.0**-52
    return np.ascontiguousarray(unit.reshape(runs, 4 * blocks).T)


class DrawTable:
    """The draws 0, 1, 2, ... of a batch of runs, fetched page by page as they are asked for.

    Args:
        seed, first, runs: which streams.
        purpose: one of the above.
        blocks: size of a page, fixed for a purpose.
    """

    def __init__(self, seed: int, first: int, runs: int, *, purpose: int, blocks: int) -> None:
        self._seed, self._first, self._runs = seed, first, runs
        self._purpose, self._blocks = purpose, blocks
        self._page = -1
        self._values = np.empty((0, runs))

    def row(self, draw: int) -> FloatArray:
        """Draw number ``draw`` of every run, shape (runs,)."""
        page, at = divmod(draw, 4 * self._blocks)
        if page != self._page:
            self._values = uniforms(self._seed, self._first, self._runs, blocks=self._blocks, purpose=self._purpose, page=page)
            self._page = page
        return np.asarray(self._values[at])
