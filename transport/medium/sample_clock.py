"""The clock of a sensor node: in which slots it has a packet to send."""

from __future__ import annotations

import numpy as np

from transport.errors import FieldError


class SampleClock:
    r"""Sample i is due in slot :math:`\mathrm{phase} + i\,\mathrm{every} + J_i`, the J independent and uniform on 0, ..., jitter.

    Args:
        every: slots between two samples, without jitter.
        phase: slot of the first, without jitter; None: drawn once, uniform on 0, ..., every - 1.
        jitter: largest J in slots, less than ``every``.
        rng: the stream of this clock; nothing else may draw from it. None where nothing is drawn.

    Raises:
        ValueError: a number that does not fit; the message begins with its name.

    >>> clock = SampleClock(every=3, phase=1)
    >>> [k for k in range(9) if clock.due(k)]
    [1, 4, 7]
    """

    def __init__(
        self, *, every: int = 1, phase: int | None = 0, jitter: int = 0, rng: np.random.Generator | None = None
    ) -> None:  # fmt: skip
        if every < 1:
            raise FieldError("every", f"{every} slots, expected at least 1")
        if not 0 <= jitter < every:
            raise FieldError("jitter", f"{jitter} slots, expected 0 to every - 1 = {every - 1}")
        if phase is not None and not 0 <= phase < every:
            raise FieldError("phase", f"{phase}, expected 0 to every - 1 = {every - 1}")
        if rng is None and (jitter or phase is None):
            raise FieldError("rng", "a clock with jitter or a random phase needs a random stream")
        self._every, self._jitter, self._rng = every, jitter, rng
        self._base = int(rng.integers(every)) if phase is None and rng is not None else phase or 0
        self._next = self._base + self._drawn()

    def _drawn(self) -> int:
        return int(self._rng.integers(self._jitter + 1)) if self._jitter and self._rng is not None else 0

    def due(self, k: int) -> bool:
        """Return whether slot k has a sample to send; called in order, in every slot."""
        if k < self._next:
            return False
        self._base += self._every
        self._next = self._base + self._drawn()
        return True
