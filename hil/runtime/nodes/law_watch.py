"""Whether a network law of the user's own draws as the chain says that it states: its modes, once the run has ended."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np

from transport.draws import Draw
from transport.law_tests.statistics import law_p_value
from transport.laws.protocols import ChainLaw, InitialLaw, NetworkLaw, SemiMarkovLaw

UNLIKELY = 1e-9
"""A record so unlikely is not of the law that is stated: one right run in 1e9 loses its certificate."""


class LawWatch:
    """Keeps the modes that a law draws.

    Args:
        law: a `ChainLaw` or a `SemiMarkovLaw`.
    """

    def __init__(self, law: NetworkLaw) -> None:
        self._law, self._ages = law, [int(age) for age in cast(ChainLaw | SemiMarkovLaw, law).mode_ages]
        self.name = type(law).__qualname__
        self._modes: list[int] = []
        self._other: tuple[int, str] | None = None

    def take(self, draws: Sequence[Draw]) -> None:
        """Take what was decided in a slot."""
        for draw in draws:
            mode = draw.mode
            if mode >= 0:
                self._modes.append(mode)
                if self._other is None and (mode >= len(self._ages) or draw.age != self._ages[mode]):
                    self._other = len(self._modes) - 1, f"an age of {draw.age} slots in mode {mode}"

    def departed(self) -> tuple[int, str] | None:
        """Return the slot in which the law left its chain, and by what; None if it did not, as far as its record can tell."""
        if self._other is not None or not self._modes:
            return self._other
        law, modes = self._law, np.array(self._modes, dtype=np.int64)
        if isinstance(law, InitialLaw) and law.initial != "stationary" and not law.initial_law()[modes[0]] > 0.0:
            return 0, f"mode {modes[0]}, in which it never begins"
        if not law_p_value(law, modes) < UNLIKELY:
            return None
        first, last = 1, len(modes)  # the first record that is as unlikely, up to a sixteenth of the run
        step = max(last // 16, 1)
        while first < last and not law_p_value(law, modes[:first]) < UNLIKELY:
            first += step
        p_value = law_p_value(law, modes[: min(first, last)])
        return min(first, last) - 1, f"modes that its chain draws with probability {p_value:.2g}"
